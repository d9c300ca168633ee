"""The cylindrical voxel grid (paper, section I, figure 2b; its size: section V-A)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from rayiou.grid import Grid, as_axis, as_shape
from rayiou.raycast.crossings import (
    Crossings,
    Distances,
    Rays,
    clip_disc,
    clip_slab,
    plane_crossings,
    ring_crossings,
    sector_crossings,
)

PAPER_RANGE_EDGES_M = (0.0, 8.5, 17.0, 25.6)
"""Ends of the paper's range bands (its Table 'result in different distance'), which end where its grid ends."""


@dataclass(frozen=True, init=False)
class Cylinder(Grid):
    """Cells along radius, azimuth and height around the ego z axis.

    Azimuth index 0 begins at -pi and the axis wraps around; azimuth runs counter-clockwise from +x. The defaults are
    the paper's grid: 0.2 m x 1.8 degrees x 0.4 m.

    Args:
        shape: cells along r, theta, z.
        radius_m: inner and outer radius.
        height_m: lower and upper end in the ego frame.

    Raises:
        ValueError: naming the size that is impossible.
    """

    shape: tuple[int, int, int]
    radius_m: tuple[float, float]
    height_m: tuple[float, float]

    def __init__(
        self,
        shape: Sequence[int] = (128, 200, 16),
        radius_m: Sequence[float | int] = (0.0, 25.6),
        height_m: Sequence[float | int] = (-2.8, 3.6),
    ) -> None:
        object.__setattr__(self, "shape", as_shape(shape))
        object.__setattr__(self, "radius_m", as_axis("radius_m", radius_m))
        object.__setattr__(self, "height_m", as_axis("height_m", height_m))
        if self.radius_m[0] < 0:
            raise ValueError(f"radius_m must not be negative, got {self.radius_m}; use (0.0, outer radius)")
        if self.shape[1] < 3:
            raise ValueError(f"shape needs at least 3 cells along theta, got {self.shape}")

    @property
    def periodic(self) -> tuple[bool, bool, bool]:
        """Return which axes wrap around: only the azimuth."""
        return (False, True, False)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Return the ends of radius (m), azimuth (rad) and height (m)."""
        return self.radius_m, (-math.pi, math.pi), self.height_m

    @property
    def cell_m(self) -> tuple[float, float, float]:
        """Return radial size, arc length at the middle radius and height of a cell, in metres."""
        arc_m = math.pi * (self.radius_m[0] + self.radius_m[1]) / self.shape[1]
        radial_m = (self.radius_m[1] - self.radius_m[0]) / self.shape[0]
        return radial_m, arc_m, (self.height_m[1] - self.height_m[0]) / self.shape[2]

    def to_axes(self, points: Float[Tensor, "... 3"]) -> tuple[Tensor, Tensor, Tensor]:
        """Return radius (m), azimuth (rad, in [-pi, pi]) and height (m)."""
        x, y, z = points.unbind(-1)
        return torch.sqrt(x * x + y * y), torch.atan2(y, x), z

    def from_axes(self, first: Tensor, second: Tensor, third: Tensor) -> Float[Tensor, "... 3"]:
        """Return points from radius (m), azimuth (rad) and height (m)."""
        return torch.stack([first * torch.cos(second), first * torch.sin(second), third], dim=-1)

    def volumes_m3(self) -> Float64[Tensor, "X Y Z"]:
        """Return the volume of every cell, which grows with the radius."""
        squared = self.edges(0).square().diff()
        cell = squared * (math.pi / self.shape[1]) * self.cell_m[2]
        return cell.reshape(-1, 1, 1).expand(self.shape).contiguous()

    def within_sides(self, points: Float[Tensor, "... 3"], margin_m: float) -> Bool[Tensor, "..."]:
        """Return which points are more than a margin inside of the outer radius; a hole around the axis is inside."""
        return torch.hypot(points[..., 0], points[..., 1]) < self.radius_m[1] - margin_m

    def clip(self, origins: Rays, directions: Rays) -> tuple[Distances, Distances]:
        """Return the distances at which rays enter and leave the cylinder; a hole around the axis is not cut out."""
        disc = clip_disc(origins, directions, self.radius_m[1])
        slab = clip_slab(origins[:, 2], directions[:, 2], self.height_m)
        return torch.maximum(disc[0], slab[0]), torch.minimum(disc[1], slab[1])

    def crossings(self, origins: Rays, directions: Rays, start_m: Distances) -> tuple[Crossings, Crossings, Crossings]:
        """Return the crossings with cylinders, half-planes and planes."""
        return (
            ring_crossings(origins, directions, start_m, self.radius_m, self.shape[0]),
            sector_crossings(origins, directions, start_m, self.shape[1]),
            plane_crossings(origins[:, 2], directions[:, 2], start_m, self.height_m, self.shape[2]),
        )
