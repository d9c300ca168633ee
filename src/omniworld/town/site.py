"""The plan of the land that is taken, and the objects that were put on the land."""

from dataclasses import dataclass, field
from math import cos, sin
from typing import NamedTuple, no_type_check

import numpy as np

from omniworld.mesh.material import Material
from omniworld.mesh.mesh import Mesh, concatenate, instances
from omniworld.mesh.shape import Color, Number, Triple, upright
from omniworld.town.road import KERB_M
from omniworld.town.terrain import Terrain
from rayiou.compiled import compiled

_CELL_M = 0.4
# No point is farther than 0.2 m from the nearest sample of a square raster of 0.28 m, however it is turned, so every
# cell (0.4 m) that lies within a rectangle has a sample.
_SAMPLE_M = 0.28


@dataclass(frozen=True)
class Pose2:
    """A position and yaw on the plan; the pose's x axis points along its yaw, y to its left."""

    x_m: Number
    y_m: Number
    yaw_rad: Number

    def at(self, along_m: Number, left_m: Number, yaw_rad: Number = 0.0) -> "Pose2":
        """Return the pose `along_m` ahead and `left_m` to the left of this one, turned further by `yaw_rad`."""
        c, s = cos(self.yaw_rad), sin(self.yaw_rad)
        return Pose2(self.x_m + c * along_m - s * left_m, self.y_m + s * along_m + c * left_m, self.yaw_rad + yaw_rad)


class Signal(NamedTuple):
    """A traffic light for the cars that reach a junction by one arm: number of the street, and whether at its end."""

    arm: tuple[int, bool]
    pose: Pose2


class Plan:
    """A grid of 0.4 m cells of land, free or taken, so that static objects overlap neither each other nor a lane."""

    def __init__(self, radius_m: float) -> None:
        self._radius_m = radius_m
        self._count = int(2 * radius_m / _CELL_M)
        self._taken = np.zeros(self._count**2, bool)

    def block(self, points_m: np.ndarray) -> None:
        """Take the cells that hold points (..., 2), in metres."""
        self._taken[self._cells(points_m[..., 0], points_m[..., 1])] = True

    def claim(self, pose: Pose2, size_m: tuple[Number, Number]) -> bool:
        """Take a rectangle (length, width) centred on the pose if all of it is free; return whether it was taken."""
        place = float(pose.x_m), float(pose.y_m), cos(pose.yaw_rad), sin(pose.yaw_rad)
        return _claim(self._taken, self._count, self._radius_m, *place, float(size_m[0]), float(size_m[1]))

    def _cells(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        x, y = ((v + self._radius_m) * (1 / _CELL_M) for v in (x_m, y_m))
        x, y = (np.minimum(np.maximum(v, 0), self._count - 1).astype(np.int64) for v in (x, y))
        return x * self._count + y


@compiled
@no_type_check
def _claim(taken, count, radius_m, x_m, y_m, c, s, length_m, width_m):
    """Take the cells of a rectangle if all are free; samples 6 m apart come first, as most claims fail there."""
    for step_m, take in ((6.0, False), (_SAMPLE_M, False), (_SAMPLE_M, True)):
        rows, columns = int(length_m / step_m) + 1, int(width_m / step_m) + 1
        for row in range(rows + 1):
            a = (row / rows - 0.5) * length_m
            for column in range(columns + 1):
                b = (column / columns - 0.5) * width_m
                x = min(max((x_m + c * a - s * b + radius_m) / _CELL_M, 0.0), count - 1.0)
                y = min(max((y_m + s * a + c * b + radius_m) / _CELL_M, 0.0), count - 1.0)
                cell = int(x) * count + int(y)
                if take:
                    taken[cell] = True
                elif taken[cell]:
                    return False
    return True


@dataclass
class Site:
    """Collects the objects of a place. Copies of one mesh are transformed in one call, which is faster."""

    terrain: Terrain
    plan: Plan
    signals: list[Signal] = field(default_factory=list)
    # By mesh and repainted materials: the mesh, a row of pose and stretch for each copy, and its colors.
    _copies: dict[tuple[int, tuple[Material, ...]], tuple[Mesh, list, list]] = field(default_factory=dict)

    def put(
        self,
        mesh: Mesh,
        pose: Pose2,
        *,
        stretch: Triple = (1.0, 1.0, 1.0),
        lift_m: Number = KERB_M,
        paint: dict[Material, Color] | None = None,
        follow: bool = False,
    ) -> None:
        """Stand a copy of `mesh` on the land, its materials in `paint` recolored; the plan is not changed.

        With `follow` the copy's x axis has the slope of the land, as a fence has.
        """
        paint = paint or {}
        _, poses, colors = self._copies.setdefault((id(mesh), tuple(paint)), (mesh, [], []))
        poses.append((pose.x_m, pose.y_m, lift_m, pose.yaw_rad, follow, *stretch))
        colors.append(tuple(paint.values()))

    def mesh(self) -> Mesh:
        """Return the mesh of all objects put so far."""
        parts = []
        for (_, materials), (prototype, rows, colors) in self._copies.items():
            x, y, lift, yaw, follow, *stretch = np.array(rows, float).T
            position = np.stack([x, y, self.terrain.height(x, y) + lift], 1)
            poses = upright(position, yaw, np.stack(stretch, 1))
            poses[:, 2, 0] = follow * stretch[0] * self._slope(x, y, yaw)
            tints = np.array(colors, np.uint8)
            parts.append(instances(prototype, poses, {m: tints[:, k] for k, m in enumerate(materials)}))
        return concatenate(parts)

    def _slope(self, x: np.ndarray, y: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        """Return the slope of the land along directions `yaw`: rise over run, between points 1.5 m ahead and behind."""
        ahead = np.stack([np.cos(yaw), np.sin(yaw)])
        front, back = (self.terrain.height(x + d * ahead[0], y + d * ahead[1]) for d in (1.5, -1.5))
        return (front - back) / 3
