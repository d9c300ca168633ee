"""What a rig alone tells of every direction of the panorama, before any image is seen."""

import torch
from jaxtyping import Float32
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.parallax import pixels_per_metre
from omniocc.model.ops.depth.spheres import Spheres
from omniocc.model.ops.rig_cache import once_per_rig

HINTS = 5
"""Number of maps."""
PROBES_M = (3.0, 12.0)
"""Ranges at which the parallax is computed."""
MANY_CAMERAS = 4
FAR_BELOW_M = 0.05
"""Least height of the road below the origin that gives it a sphere."""


@once_per_rig
def rig_hints(rig: Rig, panorama: Equirectangular, spheres: Spheres) -> Float32[Tensor, "5 h w"]:
    """Return maps of what a network must not learn by heart, since it differs between rigs; each about 0 to 1.

    Pixels of parallax between neighbouring spheres, compressed, at two ranges; how many cameras see a far point; the
    sphere on which the road lies if it is flat (0 above the horizon); whether the height of the road is known.
    """
    rays = panorama.rays().double()
    parallax = []
    for range_m in PROBES_M:
        metres_per_sphere = range_m**2 * spheres.step_per_m
        parallax.append((pixels_per_metre(rig, rays * range_m) * metres_per_sphere).log1p())
    cameras = rig.project(rays * 1e3)[1].sum(0).double() / MANY_CAMERAS
    road, known = torch.zeros_like(cameras), torch.full_like(cameras, float(rig.road_z_m is not None))
    if rig.road_z_m is not None:
        range_m = rig.road_z_m / rays[..., 2].clamp(max=-1e-6)
        road = torch.where(rays[..., 2] < 0, spheres.index(range_m.clamp(min=FAR_BELOW_M)) / spheres.count, 0)
    return torch.stack([*parallax, cameras.clamp(max=1), road.clamp(max=1), known]).float()
