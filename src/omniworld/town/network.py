"""The street network as a planar graph, and the kerb around every block.

Streets are bowed edges between the junctions of a scattered, sheared grid with some edges removed. Everything along a
street (lanes, lines, sidewalks, plots, paths of cars and walkers) is an offset of a block's *kerb ring*. A block owns
the adjacent halves of its streets, so rings of different blocks never overlap.
"""

from dataclasses import dataclass

import numpy as np

from omniworld.town.theme import Theme

_STEP_M = 3.0
_SAME_DIRECTION_RAD = 0.3  # a smaller turn continues the same street


@dataclass(frozen=True)
class Edge:
    """A street between two junctions.

    `half_width_m` is from centre line to kerb; it bows by `bulge_m` to its left, but for `straight_m` at both ends.
    """

    start: int
    end: int
    lanes: int
    half_width_m: float
    bulge_m: float
    straight_m: float


@dataclass(frozen=True)
class Side:
    """The part of a ring along one street, between the corners.

    Attributes:
        edge: index of the street.
        forward: whether the ring runs from the street's start to its end.
        along_m: (n,) distance from the junction the side starts at, along the straight line between both junctions.
        center_m: (n, 2) points of the centre line.
        kerb_m: (n, 2) points of the kerb.
    """

    edge: int
    forward: bool
    along_m: np.ndarray
    center_m: np.ndarray
    kerb_m: np.ndarray


@dataclass(frozen=True)
class Ring:
    """The kerb around one block, block to the left, closed (the last vertex joins the first).

    Attributes:
        kerb_m: (n, 2).
        normal: (n, 2) unit vectors into the block.
        inner_m: (n, 2) the street's centre line, or in corners the junction, that the kerb vertex faces.
        sides: in the order of the ring.
        outside: whether this is the land around the town.
    """

    kerb_m: np.ndarray
    normal: np.ndarray
    inner_m: np.ndarray
    sides: tuple[Side, ...]
    outside: bool

    def offset(self, into_block_m: float) -> np.ndarray:
        """Return the (n, 2) ring moved into the block or, when negative, onto the street."""
        return self.kerb_m + into_block_m * self.normal


@dataclass(frozen=True)
class Network:
    """Junctions (N, 2), streets, and one ring per block; the land around the town counts as a block."""

    junctions_m: np.ndarray
    edges: tuple[Edge, ...]
    rings: tuple[Ring, ...]


def draw(theme: Theme, rng: np.random.Generator, cells: int = 3) -> Network:
    """Draw a town of `cells` x `cells` blocks, some of them merged."""
    count = cells + 1
    position = (np.stack(np.meshgrid(range(count), range(count), indexing="ij"), -1) - cells / 2.0) * theme.spacing_m
    position = position + rng.uniform(-theme.jitter_m, theme.jitter_m, position.shape)
    turn, shear = rng.uniform(0, 2 * np.pi), rng.uniform(-0.08, 0.08)
    linear = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ np.array([[1, shear], [0, 1]])
    junctions = position.reshape(-1, 2) @ linear.T
    lanes = rng.choice(theme.lanes, (2, count))
    edges = []
    for i, j, axis in _kept_edges(rng, count, 0 if theme.island_m else count // 2):
        start, end = i * count + j, (i + (axis == 0)) * count + j + (axis == 1)
        number = int(lanes[axis, j if axis == 0 else i])
        bulge = rng.uniform(-theme.bulge_m, theme.bulge_m)
        half = number * theme.lane_width_m + theme.parking_m + 0.5 * theme.median_m
        edges.append(Edge(start, end, number, half, bulge, theme.straight_m))
    return Network(junctions, tuple(edges), _rings(junctions, tuple(edges), theme.corner_radius_m))


def _kept_edges(rng: np.random.Generator, count: int, most: int) -> list[tuple[int, int, int]]:
    """Return grid edges (i, j, axis) without at most `most` inner ones, never two around the same cell."""
    edges = [(i, j, axis) for axis in (0, 1) for i in range(count - (axis == 0)) for j in range(count - (axis == 1))]
    merged: set[tuple[int, int]] = set()
    removed = set()
    for index in rng.permutation(len(edges)):
        i, j, axis = edges[index]
        across = j if axis == 0 else i
        pair = {(i, j), (i, j - 1)} if axis == 0 else {(i, j), (i - 1, j)}
        if 0 < across < count - 1 and not pair & merged and len(removed) < most:
            merged |= pair
            removed.add((i, j, axis))
    return [edge for edge in edges if edge not in removed]


def degrees(network: Network) -> np.ndarray:
    """Return the number of streets (N,) at each junction."""
    ends = [node for edge in network.edges for node in (edge.start, edge.end)]
    return np.bincount(ends, minlength=len(network.junctions_m))


def center_line(junctions_m: np.ndarray, edge: Edge, along_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points and left normals, (n, 2) each, of a street's centre line at distances along its chord."""
    start, end = junctions_m[edge.start], junctions_m[edge.end]
    length = np.linalg.norm(end - start)
    chord = (end - start) / length
    left = np.array([-chord[1], chord[0]])
    bowed = length - 2 * edge.straight_m
    fraction = np.clip((along_m - edge.straight_m) / bowed, 0, 1)
    lateral = edge.bulge_m * np.sin(np.pi * fraction) ** 2
    slope = edge.bulge_m * np.pi / bowed * np.sin(2 * np.pi * fraction)
    normal = left - slope[:, None] * chord
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return start + along_m[:, None] * chord + lateral[:, None] * left, normal


def _rings(junctions: np.ndarray, edges: tuple[Edge, ...], radius_m: float) -> tuple[Ring, ...]:
    faces = _faces(junctions, edges)
    corners = [
        [_corner(junctions, edges, face[k], face[(k + 1) % len(face)], radius_m) for k in range(len(face))]
        for face in faces
    ]
    # (edge, at its end) -> distance from the junction at which the corner begins.
    trim: dict[tuple[int, bool], float] = {}
    for face, arcs in zip(faces, corners, strict=True):
        for k, arc in enumerate(arcs):
            edge, forward = face[k]
            after, after_forward = face[(k + 1) % len(face)]
            for key, value in (((edge, forward), arc.before_m), ((after, not after_forward), arc.after_m)):
                trim[key] = max(trim.get(key, 0.0), value + 0.5)
    return tuple(_ring(junctions, edges, face, arcs, trim) for face, arcs in zip(faces, corners, strict=True))


def _faces(junctions: np.ndarray, edges: tuple[Edge, ...]) -> list[list[tuple[int, bool]]]:
    """Return the boundary of every face as half-edges (edge, forward) with the face to the left."""
    leaving: dict[int, list[tuple[float, int, bool]]] = {}
    for index, edge in enumerate(edges):
        for node, other, forward in ((edge.start, edge.end, True), (edge.end, edge.start, False)):
            direction = junctions[other] - junctions[node]
            leaving.setdefault(node, []).append((float(np.arctan2(direction[1], direction[0])), index, forward))
    following = {}
    for around in leaving.values():
        around.sort()
        for k, (_, index, forward) in enumerate(around):
            _, after, after_forward = around[k - 1]
            following[(index, not forward)] = (after, after_forward)
    faces, unused = [], dict.fromkeys(sorted(following))
    while unused:
        half = next(iter(unused))
        face = []
        while half in unused:
            del unused[half]
            face.append(half)
            half = following[half]
        faces.append(face)
    return faces


@dataclass(frozen=True)
class _Corner:
    """Kerb arc between two sides: points and normals (k, 2), and its start's and end's distances from the junction."""

    points_m: np.ndarray
    normal: np.ndarray
    before_m: float
    after_m: float
    junction: int


def _corner(
    junctions: np.ndarray, edges: tuple[Edge, ...], half: tuple[int, bool], after: tuple[int, bool], radius_m: float
) -> _Corner:
    (u, h_u, node), (v, h_v, _) = _arrival(junctions, edges, *half), _arrival(junctions, edges, *after)
    n_u, n_v = np.array([-u[1], u[0]]), np.array([-v[1], v[0]])
    turn = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v))
    if abs(turn) < _SAME_DIRECTION_RAD:
        radius_m = 4.0 / np.tan(_SAME_DIRECTION_RAD / 2)
    elif turn < 0:
        radius_m = 2 * max(h_u, h_v)
    if abs(turn) < 0.01:
        return _Corner((junctions[node] + h_u * n_u)[None], n_u[None], 0.0, 0.0, node)
    # The kerbs cross where h_u n_u + s u = h_v n_v + q v
    s, q = np.linalg.solve(np.stack([u, -v], 1), h_v * n_v - h_u * n_u)
    tangent = radius_m * np.tan(abs(turn) / 2)
    before, after_m = tangent - s, q + tangent
    first = junctions[node] + h_u * n_u - before * u
    center = first + np.sign(turn) * radius_m * n_u
    steps = max(2, int(np.ceil(abs(turn) / np.deg2rad(13))) + 1)
    azimuth = np.arctan2(u[1], u[0]) + turn * np.linspace(0, 1, steps)
    normal = np.stack([-np.sin(azimuth), np.cos(azimuth)], 1)
    return _Corner(center - np.sign(turn) * radius_m * normal, normal, max(before, 0.0), max(after_m, 0.0), node)


def _arrival(
    junctions: np.ndarray, edges: tuple[Edge, ...], index: int, forward: bool
) -> tuple[np.ndarray, float, int]:
    """Return the direction of a half-edge, its half width, and the junction where it ends."""
    edge = edges[index]
    start, end = (edge.start, edge.end) if forward else (edge.end, edge.start)
    direction = junctions[end] - junctions[start]
    return direction / np.linalg.norm(direction), edge.half_width_m, end


def _ring(
    junctions: np.ndarray,
    edges: tuple[Edge, ...],
    face: list[tuple[int, bool]],
    corners: list[_Corner],
    trim: dict[tuple[int, bool], float],
) -> Ring:
    kerb, normals, inner, sides = [], [], [], []
    for (index, forward), corner in zip(face, corners, strict=True):
        edge = edges[index]
        length = float(np.linalg.norm(junctions[edge.end] - junctions[edge.start]))
        first, last = trim[(index, False)], length - trim[(index, True)]
        along = np.linspace(first, last, max(2, int(np.ceil((last - first) / _STEP_M)) + 1))
        center, left = center_line(junctions, edge, along)
        if not forward:
            center, left, along = center[::-1], -left[::-1], length - along[::-1]
        sides.append(Side(index, forward, along, center, center + edge.half_width_m * left))
        kerb += [sides[-1].kerb_m, corner.points_m]
        normals += [left, corner.normal]
        inner += [center, np.tile(junctions[corner.junction], (len(corner.points_m), 1))]
    points = np.concatenate(kerb)
    x, y = points.T
    area = 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    return Ring(points, np.concatenate(normals), np.concatenate(inner), tuple(sides), area < 0)
