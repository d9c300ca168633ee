"""Spheres around the ego origin at equal steps of inverse range, and the radius of the nearest."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.bounds import Size
from omniocc.camera import Equirectangular, Rig
from omniocc.model.ops.rig_cache import once_per_rig

FINEST = 0.1
"""Smallest index that has a range of its own: a tenth of a step from infinity."""
OVERLAP = 0.9
"""Smallest fraction of the seen directions that two cameras see on the nearest sphere."""
LEAST_M = 0.5
"""Smallest radius of the nearest sphere."""


@dataclass(frozen=True)
class Spheres:
    """Map between ranges and indices of spheres: 0 is infinity, `count - 1` the nearest (Won et al. 2019, section 3.2).

    Neighbours at range r are r^2 / (min_range_m * (count - 1)) metres apart.

    Attributes:
        count: number of spheres, the one at infinity included.
        min_range_m: radius of the nearest.
    """

    count: int
    min_range_m: float

    def __post_init__(self) -> None:
        """Raise ValueError unless there are two spheres or more and the nearest has a positive radius."""
        if isinstance(self.count, bool) or not isinstance(self.count, int) or self.count < 2:
            raise ValueError(f"count of spheres is {self.count!r}; it must be a whole number of at least 2")
        if not 0 < self.min_range_m < float("inf"):
            raise ValueError(f"min_range_m is {self.min_range_m!r}; it must be above 0, in metres")

    @property
    def step_per_m(self) -> float:
        """Return the difference in inverse range between neighbours, 1/m."""
        return 1 / (self.min_range_m * (self.count - 1))

    @property
    def farthest_m(self) -> float:
        """Return the upper limit of ranges, m: a tenth of a step from infinity."""
        return 1 / (FINEST * self.step_per_m)

    def index(self, range_m: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Return fractional indices of ranges (m): 0 for infinity, above `count - 1` nearer than all spheres."""
        return 1 / (range_m * self.step_per_m)

    def range_m(self, index: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Return ranges of indices, m, at most `farthest_m`; the inverse of `index`."""
        return (index.clamp(min=FINEST) * self.step_per_m).reciprocal()


@once_per_rig
def nearest_range_m(rig: Rig, panorama: Equirectangular) -> float:
    """Return the radius of the nearest sphere of a rig, m.

    It is the smallest range, between 1 and 3 times the distance of the outermost camera from the origin, at which two
    cameras see 90 % of the directions that any camera sees. Where there is no such range, because fields of view hardly
    overlap (pinhole cameras, or four fisheyes around a car), it is twice the distance of the innermost camera. It is
    not farther than a flat road at the lower edge of the panorama, if the rig says how high the road is, and never
    under 0.5 m. Masks do not count: the own car hides directions below the horizon at every range.
    """
    road_m = road_range_m(rig.road_z_m, panorama.bottom_deg)
    rig = replace(rig, masks=None)
    distances_m = rig.ego_from_camera[:, :3, 3].norm(dim=-1)
    rays = panorama.resized(128, 32).rays().double()
    nearest_m = 2 * float(distances_m.min())
    for ranges_m in (torch.linspace(1, 3, 41).double() * distances_m.max()).split(8):
        cameras = rig.project(rays * ranges_m.reshape(-1, 1, 1, 1))[1].sum(0)
        seen, overlap = (cameras >= 1).sum((1, 2)), (cameras >= 2).sum((1, 2))
        enough = (seen > 0) & (overlap / seen >= OVERLAP)
        if bool(enough.any()):
            nearest_m = float(ranges_m[enough][0])
            break
    return max(LEAST_M, round(min(nearest_m, road_m), 3))


def road_range_m(road_z_m: float | None, elevation_deg: float) -> float:
    """Return the range, m, of a flat road at an elevation; infinite above the horizon and where it is not known."""
    if road_z_m is None or road_z_m >= 0 or elevation_deg >= 0:
        return math.inf
    return road_z_m / math.sin(math.radians(elevation_deg))


@dataclass(frozen=True)
class SphereRange:
    """Number and reach of the spheres that a depth option uses for every rig.

    Attributes:
        count: number of spheres, the one at infinity included.
        min_range_m: radius of the nearest; None derives it from each rig (`nearest_range_m`).
    """

    count: Size
    min_range_m: float | None

    def __post_init__(self) -> None:
        """Raise ValueError as `Spheres` does."""
        Spheres(self.count, 1.0 if self.min_range_m is None else self.min_range_m)

    @property
    def planes(self) -> tuple[float, ...]:
        """Return the index of every sphere."""
        return tuple(float(k) for k in range(self.count))

    def of(self, rig: Rig, panorama: Equirectangular) -> Spheres:
        """Return the spheres of a rig, whose directions are those of a panorama."""
        return Spheres(self.count, nearest_range_m(rig, panorama) if self.min_range_m is None else self.min_range_m)
