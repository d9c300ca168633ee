"""The flat road below a rig, in the ranges that a depth network predicts which is told the road's height."""

import math
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.errors import UserError
from omniocc.model.depth import DepthMap, Spheres

EDGES_M = (8.5, 17.0)
"""Distances of the road up to which its height is measured, band by band."""
LIKE_ROAD = 0.25
"""Relative difference up to which a predicted range counts as one of the road."""
WITHIN = 0.25
"""The value of `within` for `pulled_to_road`, in spheres, where nothing else is chosen."""

NO_ROAD = (
    "its height is not known: write road_z_m into the rig file or give it here, such as road_z_m=-0.9 where the road "
    "is 0.9 m below the rig's origin. Without it 44, not 80 % of any-rig's ranges on a flat cloth were within 10 %"
)
"""What a user is told about a rig that does not state the height of the road, and a network that is told it."""


def check_within(value: object) -> float:
    """Return the option `road_within`; raise UserError unless it is a number of spheres, 0 or more."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < math.inf:
        raise UserError(f"road_within={value}: it must be a number of spheres, 0 or more; 0 leaves ranges as they are")
    return float(value)


def flat_road_m(panorama: Equirectangular, road_z_m: float) -> Float[Tensor, "h w"]:
    """Return the range of a flat road in every direction, m; infinite above the horizon."""
    down = panorama.rays()[..., 2]
    return torch.where(down < 0, road_z_m / down.clamp(max=-1e-6), torch.inf)


def pulled_to_road(depth: DepthMap, spheres: Spheres, flat_m: Float[Tensor, "h w"], within: float) -> DepthMap:
    """Return ranges of which those closest to a flat road are drawn onto it.

    A distance x from the road becomes x * (1 - exp(-(x / within)^2)), in spheres of inverse range: centimetres near by,
    metres far away, as the spheres are. Confidence and validity stay.

    Args:
        depth: of a network that is told the height of the road.
        spheres: to which its indices refer.
        flat_m: range of a flat road, infinite above the horizon, where ranges stay.
        within: spheres, above 0.
    """
    road = spheres.index(flat_m)
    away = depth.index - road
    near = road + away * (1 - (-((away / within) ** 2)).exp())
    index = torch.where(flat_m.isfinite(), near, depth.index)
    return depth._replace(index=index, range_m=torch.where(flat_m.isfinite(), spheres.range_m(index), depth.range_m))


def road_line(range_m: Float[Tensor, "h w"], panorama: Equirectangular, road_z_m: float) -> str:
    """Return in words at what height a panorama, nan where it has no answer, puts the road; empty if it shows none.

    In each band of `EDGES_M`, the distance of a flat road, it is the median height of what lies about where it would.
    """
    flat_m, down = flat_road_m(panorama, road_z_m), panorama.rays()[..., 2]
    like_road = (range_m / flat_m - 1).abs() < LIKE_ROAD
    distance_m, found, near_m = flat_m * (1 - down**2).sqrt(), [], 0.0
    for far_m in EDGES_M:
        band = like_road & (distance_m > near_m) & (distance_m <= far_m)
        if bool(band.any()):
            found.append(f"{float((range_m * down)[band].median()):.2f} m at {near_m:g}-{far_m:g} m")
        near_m = far_m
    return f"road at {', '.join(found)} (road_z_m: {road_z_m:g} m)" if found else ""


def on_road(depth: DepthMap, model: nn.Module, rig: Rig, within: float) -> DepthMap:
    """Return a frame's depth with `pulled_to_road`, if the network is told the height and `within` is above 0."""
    if within == 0 or rig.road_z_m is None or not getattr(model, "hints", False):
        return depth
    flat_m = flat_road_m(cast(Equirectangular, model.panorama), rig.road_z_m)
    return pulled_to_road(depth, cast(Spheres, model.rig_spheres(rig)), flat_m, within)  # type: ignore[operator]
