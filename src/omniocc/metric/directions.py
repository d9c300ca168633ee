"""The public set of LiDAR rays."""

import math

import torch
from jaxtyping import Float32
from torch import Tensor


def sparseocc_directions() -> Float32[Tensor, "14040 3"]:
    """The 39 x 360 unit directions of the public RayIoU (SparseOcc, Liu et al. 2024), elevation by elevation.

    The ten lowest elevations, -atan(1/k) for k = 1..10, meet flat ground at 1, 2, .. 10 times the sensor's height; the
    others continue upwards by atan(10) - atan(9) while the last one is below 0.21 rad. Azimuths are 0, 1, .. 359
    degrees, counter-clockwise from +x.
    """
    elevations = [-math.atan(1 / k) for k in range(1, 11)]
    while elevations[-1] < 0.21:
        elevations.append(elevations[-1] + math.atan(10) - math.atan(9))
    elevation, azimuth = torch.meshgrid(
        torch.tensor(elevations, dtype=torch.float64), torch.arange(360).double().deg2rad(), indexing="ij"
    )
    level = elevation.cos()
    return torch.stack([level * azimuth.cos(), level * azimuth.sin(), elevation.sin()], dim=-1).reshape(-1, 3).float()
