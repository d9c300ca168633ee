"""Spheres around the ego origin at equal steps of inverse range, and how near the nearest should be."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.camera import Equirectangular, Rig

FINEST = 0.1
"""Index from which on ranges are told apart: a tenth of a step from infinity."""
OVERLAP = 0.9
LEAST_M = 0.5


@dataclass(frozen=True)
class Spheres:
    """`count` spheres; index 0 is infinity, index `count - 1` the nearest (OmniMVS, Won et al. 2019, section 3.2).

    Between neighbours at range r lie r^2 / (min_range_m * (count - 1)) metres.

    Attributes:
        count: number of spheres, the one at infinity included.
        min_range_m: radius of the nearest.
    """

    count: int
    min_range_m: float

    def __post_init__(self) -> None:
        """Raises ValueError for a number or a radius that no spheres have."""
        if isinstance(self.count, bool) or not isinstance(self.count, int) or self.count < 2:
            raise ValueError(f"spheres is {self.count!r}; it must be a whole number of at least 2")
        if not 0 < self.min_range_m < float("inf"):
            raise ValueError(f"min_range_m is {self.min_range_m!r}; it must be above 0, in metres")

    @property
    def step_per_m(self) -> float:
        """Difference in inverse range between neighbours, 1/m."""
        return 1 / (self.min_range_m * (self.count - 1))

    @property
    def farthest_m(self) -> float:
        """What ranges are clamped to: a tenth of a step from infinity."""
        return 1 / (FINEST * self.step_per_m)

    def index(self, range_m: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Where ranges lie among the spheres, with fractions; infinity has 0, what is nearer than all has more."""
        return 1 / (range_m * self.step_per_m)

    def range_m(self, index: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Inverse of `index`, at most `farthest_m`."""
        return 1 / (index.clamp(min=FINEST) * self.step_per_m)

    def radii_m(self) -> tuple[float, ...]:
        """Radius of every sphere, infinity first."""
        return (float("inf"), *(1 / (k * self.step_per_m) for k in range(1, self.count)))


@lru_cache(maxsize=64)
def nearest_range_m(rig: Rig, panorama: Equirectangular) -> float:
    """How near the nearest sphere of a rig should be, m.

    The smallest range, between 1 and 3 times the distance of the outermost camera from the origin, at which two cameras
    see nine tenths of the directions that any camera sees there. Where fields hardly overlap (six pinhole cameras) no
    range does; then twice that distance. Never under 0.5 m.
    """
    outermost_m = float(rig.ego_from_camera[:, :3, 3].norm(dim=-1).max())
    rays = panorama.resized(128, 32).rays().double()
    nearest_m = 2 * outermost_m
    for factor in torch.linspace(1, 3, 41).tolist():
        cameras = rig.project(rays * (factor * outermost_m))[1].sum(0)
        if bool((cameras >= 1).any()) and float((cameras >= 2).sum() / (cameras >= 1).sum()) >= OVERLAP:
            nearest_m = factor * outermost_m
            break
    return max(LEAST_M, round(nearest_m, 3))


def rig_spheres(rig: Rig, panorama: Equirectangular, count: int, min_range_m: float | None) -> Spheres:
    """The spheres of a rig: `min_range_m` as given, or from the rig."""
    return Spheres(count, nearest_range_m(rig, panorama) if min_range_m is None else min_range_m)
