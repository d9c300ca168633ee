"""Labels from geometry: points spread evenly over all surfaces near the ego, visible or not."""

import numpy as np

from omniworld.mesh.mesh import Mesh
from omniworld.render.snapshot import Snapshot
from omniworld.sensors.thinning import REACH_M, within_reach

_POINT_M2 = 0.0125  # area per point far from the ego: three points in a square of 0.2 m
_POINT_M = 0.0016  # area per point and metre of distance near the ego: four points in a cell of the paper's cylinder
_PIECE_M2 = 2.0
_PIECE_FRACTION = 0.1  # greatest area of a piece as a fraction of its squared distance from the axis
_AXIS_M = 0.06  # distance below which points do not get denser
_COVER_M = 0.1  # a surface with another one closer than this above it is covered
_LIFT_M = np.float32(0.002)  # less than a road line's height above its road
_STEP = np.array([0.7548776662466927, 0.5698402909980532])


class GeometryLabels:
    """Surface points of a scene (mesh of its static objects) without any sensor.

    Every surface counts, also backs of houses, undersides of cars and the inside of closed houses; only surfaces that
    another one covers at less than 0.1 m (the road under its paint) do not.
    """

    def __init__(self, static: Mesh) -> None:
        self._static = static
        corner = static.vertices[static.faces][..., :2]
        self._low, self._high = corner.min(axis=1), corner.max(axis=1)

    def scan(self, snapshot: Snapshot) -> tuple[np.ndarray, np.ndarray]:
        """Return points (P, 3) float32 in the ego frame and their classes (P,) uint8."""
        ego = snapshot.origin_m[:2]
        # Half the side of a level square that contains the ego's square at any yaw and tilt.
        reach = np.float32(REACH_M * 1.5)
        near = np.flatnonzero(((self._low < ego + reach) & (self._high > ego - reach)).all(axis=1))
        corners = [self._static.vertices[self._static.faces[near]], snapshot.moving.vertices[snapshot.moving.faces]]
        labels = np.concatenate([self._static.label[near], snapshot.moving.label])
        around = snapshot.ego_points(np.concatenate(corners).reshape(-1, 3)).reshape(-1, 3, 3)
        pieces, number = cut(around, REACH_M)
        points, normal, piece = spread(pieces)
        keep = np.flatnonzero(within_reach(points))
        points, normal, label = points[keep], normal[piece[keep]], labels[number[piece[keep]]]
        lifted = snapshot.world_directions((points + normal * _LIFT_M).T).T + snapshot.origin_m
        free = ~snapshot.layers.blocked(lifted, np.ascontiguousarray(snapshot.world_directions(normal.T).T), _COVER_M)
        return points[free], label[free]


def cut(corners: np.ndarray, reach_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Halve triangles (F, 3, 3) in the ego frame along their longest edges until they are small; drop distant ones.

    Small is at most 2 m2 and, except for the innermost, a tenth of the squared distance from the ego's axis. `reach_m`
    is half the side of the square that counts. Return the pieces (N, 3, 3) and the index (N,) of each one's triangle.
    """
    number = np.arange(len(corners))
    done: list[tuple[np.ndarray, np.ndarray]] = []
    while len(corners) or not done:
        flat = corners[..., :2]
        inside = ((flat.min(axis=1) < reach_m) & (flat.max(axis=1) > -reach_m)).all(axis=1)
        corners, number = corners[inside], number[inside]
        large = _area_normal(corners)[0] > np.minimum(_PIECE_FRACTION * _distance_m(corners) ** 2, _PIECE_M2)
        done.append((corners[~large], number[~large]))
        corners, number = _halves(corners[large]), np.repeat(number[large], 2)
    return np.concatenate([piece for piece, _ in done]), np.concatenate([index for _, index in done])


def _halves(corners: np.ndarray) -> np.ndarray:
    edge = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    first, row = edge.argmax(axis=1), np.arange(len(corners))
    a, b, c = (corners[row, (first + k) % 3] for k in range(3))
    middle = 0.5 * (a + b)
    return np.stack([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)], axis=1).reshape(-1, 3, 3)


def spread(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spread points evenly over triangles (F, 3, 3), at least one on each.

    Near the ego's axis, where the cells of a cylinder are narrow, they are denser. Return points (P, 3), unit normals
    (F, 3), both float32, and the index (P,) of each point's triangle.
    """
    area, normal = _area_normal(corners)
    count = np.ceil(area / np.minimum(_POINT_M * _distance_m(corners), _POINT_M2)).astype(np.int64)
    count = np.maximum(count, 1)
    triangle = np.repeat(np.arange(len(corners)), count)
    step = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    # The additive recurrence of Roberts (2018) fills a square evenly; folding it along the diagonal fills a triangle.
    u, v = ((step[:, None] + 0.5) * _STEP + triangle[:, None] * _STEP[::-1]).T % 1
    fold = u + v > 1
    u, v = (np.where(fold, 1 - x, x).astype(np.float32)[:, None] for x in (u, v))
    a, b, c = (corners[:, k][triangle] for k in range(3))
    return a * (1 - u - v) + b * u + c * v, normal, triangle


def _distance_m(corners: np.ndarray) -> np.ndarray:
    """Return the (F,) distance of the triangles' centres from the ego's axis, at least `_AXIS_M`."""
    return np.maximum(np.hypot(*corners[..., :2].mean(axis=1).T), _AXIS_M)


def _area_normal(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return 0.5 * length, cross / np.maximum(length, 1e-12)[:, None]
