"""The public set of LiDAR rays, and the places they start from."""

import math

import torch
from jaxtyping import Float, Float64
from torch import Tensor


def sparseocc_directions() -> Float64[Tensor, "14040 3"]:
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
    # a quarter turn ends exactly on an axis
    x, y = (part.masked_fill(part.abs() < 1e-15, 0.0) for part in (azimuth.cos(), azimuth.sin()))
    return torch.stack([elevation.cos() * x, elevation.cos() * y, elevation.sin()], dim=-1).reshape(-1, 3)


def eight_origins(positions_m: Float[Tensor, "F 3"], reach_m: float = 39.0, most: int = 8) -> Float[Tensor, "O 3"]:
    """The public protocol's choice of places that one frame's rays start from.

    Args:
        positions_m: where the LiDAR was in all frames of the scene, past and future ones, in the ego frame of the frame
            that is scored, in order of time.
        reach_m: places count whose x and y are both nearer than this; z is not looked at.
        most: of more places than this, the first, the last and evenly many between them are taken, with which the
            frame's own place may be left out.

    Returns:
        At most `most` places. Those of a standing car repeat, and count as often.

    Example:
        >>> drive = torch.zeros(20, 3)
        >>> drive[:, 0] = torch.arange(20) * 5.0 - 50.0
        >>> eight_origins(drive)[:, 0].tolist()
        [-35.0, -25.0, -15.0, -5.0, 5.0, 15.0, 25.0, 35.0]
    """
    near = positions_m[(positions_m[:, :2].abs() < reach_m).all(dim=1)]
    if len(near) <= most:
        return near
    return near[torch.linspace(0, len(near) - 1, most, dtype=torch.float64).round().long().to(near.device)]
