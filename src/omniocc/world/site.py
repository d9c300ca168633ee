"""Where things stand: a plan of the free land, and a list of what was put on it."""

from dataclasses import dataclass, field

import numpy as np

from omniocc.world.material import Material
from omniocc.world.mesh import Mesh, concatenate, instances
from omniocc.world.road import KERB_M
from omniocc.world.shape import Color, similarity
from omniocc.world.terrain import Terrain

_CELL_M = 0.4


@dataclass(frozen=True)
class Pose2:
    """A place on the plan: position and heading; x runs along the heading, y to its left."""

    x_m: float
    y_m: float
    yaw_rad: float

    def at(self, along_m: float, left_m: float, yaw_rad: float = 0.0) -> "Pose2":
        """The pose with these coordinates in this pose's own frame."""
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x, y = self.x_m + cos * along_m - sin * left_m, self.y_m + sin * along_m + cos * left_m
        return Pose2(float(x), float(y), self.yaw_rad + yaw_rad)


class Plan:
    """Which land is taken, on a grid of 0.4 m: nothing static stands in another or on a lane."""

    def __init__(self, radius_m: float) -> None:
        self._radius_m = radius_m
        count = int(2 * radius_m / _CELL_M)
        self._taken = np.zeros((count, count), bool)

    def block(self, points_m: np.ndarray) -> None:
        """Takes the cells of (..., 2) points."""
        index = self._cells(points_m)
        self._taken[index[..., 0], index[..., 1]] = True

    def claim(self, pose: Pose2, size_m: tuple[float, float]) -> bool:
        """Takes a rectangle centred on the pose, if all of it is free."""
        (length, width), cos, sin = size_m, np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
        a = np.linspace(-length / 2, length / 2, int(length / 0.28) + 2)[:, None]
        b = np.linspace(-width / 2, width / 2, int(width / 0.28) + 2)[None]
        index = self._cells(np.stack([pose.x_m + cos * a - sin * b, pose.y_m + sin * a + cos * b], -1))
        if self._taken[index[..., 0], index[..., 1]].any():
            return False
        self._taken[index[..., 0], index[..., 1]] = True
        return True

    def _cells(self, points_m: np.ndarray) -> np.ndarray:
        index = np.floor((points_m + self._radius_m) / _CELL_M).astype(np.int64)
        return np.clip(index, 0, len(self._taken) - 1)


@dataclass
class Site:
    """Collects the things of a place; copies of one prototype are laid out together, which is fast."""

    terrain: Terrain
    plan: Plan
    _copies: dict[int, tuple[Mesh, list, list, Material | None]] = field(default_factory=dict)

    def put(
        self, mesh: Mesh, pose: Pose2, *, scale: float = 1.0, lift_m: float = KERB_M, material: Material | None = None,
        color: Color = (0, 0, 0),
    ) -> None:  # fmt: skip
        """Stands a copy of `mesh` on the land; faces of `material` take `color`. Claims nothing on the plan."""
        _, poses, colors, _ = self._copies.setdefault(id(mesh), (mesh, [], [], material))
        poses.append((pose.x_m, pose.y_m, lift_m, pose.yaw_rad, scale))
        colors.append(color)

    def mesh(self) -> Mesh:
        """Everything put so far."""
        parts = []
        for prototype, rows, colors, material in self._copies.values():
            x, y, lift, yaw, scale = np.array(rows).T
            position = np.stack([x, y, self.terrain.height(x, y) + lift], 1)
            parts.append(instances(prototype, similarity(position, yaw, scale), material, np.array(colors, np.uint8)))
        return concatenate(parts)
