"""Lanes along the streets, turns over the junctions, and which turns clash.

Traffic keeps right: the lanes of a half street run against its block's ring, with the block to their right.
"""

from dataclasses import dataclass, replace

import numpy as np

from omniworld.town.line import arc_lengths, interpolate
from omniworld.town.marking import stop_m
from omniworld.town.network import Network, Side, degrees
from omniworld.town.road import CROWN_M
from omniworld.town.terrain import Terrain
from omniworld.town.theme import Theme

STEP_M = 0.5  # distance of a path's points
_ROUNDING = np.hanning(15)[1:-1] / np.hanning(15).sum()  # over 7 m
_LATERAL_MPS2 = 2.2
_ROOM_M, _STRAIGHT_ROOM_M = 3.8, 2.75  # least distance of two vehicles' middles: turning, both going straight
_SAMPLES = 20
_STRAIGHT_RAD = 0.5


@dataclass(frozen=True)
class Path:
    """A path: (n, 3) points at (n,) arc lengths."""

    points_m: np.ndarray
    along_m: np.ndarray

    @property
    def length_m(self) -> float:
        """Return the length of the whole path."""
        return float(self.along_m[-1])

    def at(self, along_m: np.ndarray) -> np.ndarray:
        """Return (..., 3) positions at arc lengths."""
        return interpolate(along_m, self.along_m, self.points_m)


def close(points_m: np.ndarray) -> Path:
    """Return the path along (n, 3) points and back to the first, its corners rounded by some centimetres."""
    closed = np.concatenate([points_m, points_m[:1]])
    along = arc_lengths(closed)
    fine = np.linspace(0, along[-1], int(np.ceil(along[-1] / STEP_M)) + 1)[:-1]
    even = interpolate(fine, along, closed)
    reach = len(_ROUNDING) // 2
    padded = np.concatenate([even[-reach:], even, even[:reach]])
    rounded = np.stack([np.convolve(padded[:, k], _ROUNDING, "valid") for k in range(3)], -1)
    rounded = np.concatenate([rounded, rounded[:1]])
    return Path(rounded, arc_lengths(rounded))


Arm = tuple[int, bool]
"""A street's end at a junction: (street, at its end)."""


@dataclass(frozen=True)
class Piece(Path):
    """A lane or a turn, with a speed limit."""

    speed_mps: float


@dataclass(frozen=True)
class Lane:
    """A lane between two arms, its number from the kerb, and where a car's front stops before its end."""

    start: Arm
    end: Arm
    number: int
    stop_m: float


@dataclass(frozen=True)
class Turn:
    """A path over a junction between two lanes; `clashes` must not be used at the same time. All are piece numbers."""

    origin: int
    target: int
    clashes: frozenset[int]


@dataclass(frozen=True)
class Roads:
    """All pieces: first the lanes, then the turns; `onward` gives the turns that leave each lane."""

    pieces: tuple[Piece, ...]
    lanes: tuple[Lane, ...]
    turns: tuple[Turn, ...]
    onward: tuple[tuple[int, ...], ...]

    def turn(self, piece: int) -> Turn:
        """Return the turn with this piece number."""
        return self.turns[piece - len(self.lanes)]


def draw(
    theme: Theme, network: Network, terrain: Terrain, crossings: frozenset[Arm], rng: np.random.Generator
) -> Roads:
    """Draw lanes with their free speeds, and all turns that traffic rules allow."""
    lanes, pieces = [], []
    speeds = rng.uniform(*theme.speed_mps, len(network.edges))
    for side in (side for ring in network.rings for side in ring.sides):
        start, end = (side.edge, side.forward), (side.edge, not side.forward)
        for number in range(network.edges[side.edge].lanes):
            pieces.append(_lane_piece(theme, network, terrain, side, number, float(speeds[side.edge])))
            lanes.append(Lane(start, end, number, pieces[-1].length_m - stop_m(end in crossings)))
    turns, meeting = [], degrees(network)
    for origin, target, angle in _pairs(network, lanes, pieces):
        node = node_of(network, lanes[origin].end)
        island_m = theme.island_m if meeting[node] > 3 else 0.0
        pieces.append(_turn_piece(pieces[origin], pieces[target], network.junctions_m[node], island_m, terrain))
        turns.append((origin, target, angle))
    first = len(lanes)
    clashes = _clashes(network, lanes, turns, pieces[first:])
    onward = tuple(tuple(first + k for k, turn in enumerate(turns) if turn[0] == lane) for lane in range(first))
    built = tuple(
        Turn(origin, target, frozenset(first + k for k in clash))
        for (origin, target, _), clash in zip(turns, clashes, strict=True)
    )
    return Roads(tuple(pieces), tuple(lanes), built, onward)


def node_of(network: Network, arm: Arm) -> int:
    """Return the junction at an arm."""
    edge = network.edges[arm[0]]
    return edge.end if arm[1] else edge.start


def _piece(points_m: np.ndarray, speed_mps: float) -> Piece:
    """Resample points to steps of half a metre."""
    along = arc_lengths(points_m)
    fine = np.linspace(0, along[-1], int(along[-1] / STEP_M) + 2)
    return Piece(interpolate(fine, along, points_m), fine, speed_mps)


def _lane_piece(theme: Theme, network: Network, terrain: Terrain, side: Side, number: int, speed_mps: float) -> Piece:
    from_kerb_m = theme.parking_m + (number + 0.5) * theme.lane_width_m
    fraction = from_kerb_m / network.edges[side.edge].half_width_m
    low, high = terrain.points(side.kerb_m), terrain.points(side.center_m, CROWN_M)
    return _piece((low + fraction * (high - low))[::-1], speed_mps)


def _pairs(network: Network, lanes: list[Lane], pieces: list[Piece]) -> list[tuple[int, int, float]]:
    """Return (origin, target, angle) of turns: right from the lane at the kerb, left from the innermost."""
    pairs = []
    for origin, lane in enumerate(lanes):
        arrival = pieces[origin].points_m[-1, :2] - pieces[origin].points_m[-2, :2]
        last = network.edges[lane.end[0]].lanes - 1
        options = []
        for target, other in enumerate(lanes):
            if other.start == lane.end or node_of(network, other.start) != node_of(network, lane.end):
                continue
            leave = pieces[target].points_m[1, :2] - pieces[target].points_m[0, :2]
            angle = float(np.arctan2(arrival[0] * leave[1] - arrival[1] * leave[0], arrival @ leave))
            inner = network.edges[other.start[0]].lanes - 1
            if abs(angle) > _STRAIGHT_RAD or other.number == min(lane.number, inner):
                options.append((origin, target, angle))
        options.sort(key=lambda option: option[2])
        kept = [
            option
            for option in options
            if abs(option[2]) <= _STRAIGHT_RAD
            or (option[2] < 0 and lane.number == 0)
            or (option[2] > 0 and lane.number == last)
        ]
        pairs += kept or options[:1]
    return pairs


def _turn_piece(origin: Piece, target: Piece, node: np.ndarray, island_m: float, terrain: Terrain) -> Piece:
    a, b = origin.points_m[-1], target.points_m[0]
    ahead, leave = (x.points_m[k, :2] - x.points_m[k - 1, :2] for x, k in ((origin, -1), (target, 1)))
    ahead, leave = ahead / np.linalg.norm(ahead), leave / np.linalg.norm(leave)
    xy = _bend(a[:2], ahead, b[:2], leave)
    if island_m:
        first, last = (np.arctan2(*(p[:2] - node)[::-1]) for p in (a, b))
        sweep = (last - first) % (2 * np.pi)
        if sweep > 1.5:
            angle = first + np.linspace(0.62, sweep - 0.62, 12)
            ring = node + (island_m + 2.4) * np.stack([np.cos(angle), np.sin(angle)], 1)
            tangent = np.stack([-np.sin(angle), np.cos(angle)], 1)
            into, out = _bend(a[:2], ahead, ring[0], tangent[0]), _bend(ring[-1], tangent[-1], b[:2], leave)
            xy = np.concatenate([into[:-1], ring, out[1:]])
    start, end = (float(p[2]) - float(terrain.height(p[0], p[1])) for p in (a, b))
    piece = _piece(terrain.points(xy, np.linspace(start, end, len(xy))), 1.0)
    speed = min(origin.speed_mps, target.speed_mps, float(np.sqrt(_LATERAL_MPS2 * _least_radius_m(piece))))
    return replace(piece, speed_mps=max(speed, 2.5))


def _bend(a: np.ndarray, ahead: np.ndarray, b: np.ndarray, leave: np.ndarray) -> np.ndarray:
    """Return a (25, 2) cubic curve between two points and directions, close to an arc."""
    reach, t = 0.39 * float(np.linalg.norm(b - a)), np.linspace(0, 1, 25)[:, None]
    first, second = a + reach * ahead, b - reach * leave
    return (1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * first + 3 * t**2 * (1 - t) * second + t**3 * b


def _least_radius_m(piece: Piece) -> float:
    """Return the least radius of curvature, over chords of 3 m."""
    points = piece.points_m[:, :2]
    step = min(6, (len(points) - 1) // 3)
    if step == 0:
        return np.inf
    chord = points[step:] - points[:-step]
    azimuth = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
    turn = np.abs(azimuth[step:] - azimuth[:-step]).max()
    return STEP_M * step / max(float(turn), 1e-3)


def _clashes(
    network: Network, lanes: list[Lane], turns: list[tuple[int, int, float]], pieces: list[Piece]
) -> list[set[int]]:
    clashes: list[set[int]] = [set() for _ in turns]
    nodes = np.array([node_of(network, lanes[origin].end) for origin, _, _ in turns])
    spread = [piece.at(np.linspace(0, piece.length_m, _SAMPLES))[:, :2] for piece in pieces]
    straight = np.array([abs(angle) < _STRAIGHT_RAD for _, _, angle in turns])
    for node in np.unique(nodes):
        at_node = np.flatnonzero(nodes == node)
        points = np.stack([spread[k] for k in at_node])
        flat = points.reshape(-1, 2)
        away = ((flat[:, None] - flat[None]) ** 2).sum(-1).reshape(len(at_node), _SAMPLES, len(at_node), _SAMPLES)
        least = np.sqrt(away.min((1, 3)))
        room = np.where(straight[at_node][:, None] & straight[at_node][None], _STRAIGHT_ROOM_M, _ROOM_M)
        for i, j in np.argwhere(least < room):
            if i != j:
                clashes[at_node[i]].add(int(at_node[j]))
    return clashes
