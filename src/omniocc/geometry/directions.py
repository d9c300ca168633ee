"""Directions and origins of the LiDAR rays of the public RayIoU."""

import math

import torch
from jaxtyping import Float, Float64
from torch import Tensor


def sparseocc_directions() -> Float64[Tensor, "14040 3"]:
    """Return the 39 x 360 unit directions of the public RayIoU (SparseOcc, Liu et al. 2024), elevation by elevation.

    The ten lowest elevations, -atan(1/k) for k = 1..10, hit flat ground at 1, 2, .. 10 times the sensor's height; the
    others continue upwards by atan(10) - atan(9) while the last one is below 0.21 rad. Azimuths are 0, 1, .. 359
    degrees, counter-clockwise from +x.
    """
    elevations = [-math.atan(1 / k) for k in range(1, 11)]
    while elevations[-1] < 0.21:
        elevations.append(elevations[-1] + math.atan(10) - math.atan(9))
    elevation, azimuth = torch.meshgrid(
        torch.tensor(elevations, dtype=torch.float64), torch.arange(360).double().deg2rad(), indexing="ij"
    )
    # directions at multiples of 90 degrees are exactly on an axis
    x, y = (part.masked_fill(part.abs() < 1e-15, 0.0) for part in (azimuth.cos(), azimuth.sin()))
    return torch.stack([elevation.cos() * x, elevation.cos() * y, elevation.sin()], dim=-1).reshape(-1, 3)


def rays_around(azimuths: int) -> Float64[Tensor, "R 3"]:
    """Return unit directions at the 39 elevations of the public RayIoU, in fewer azimuths, half a step off +x."""
    ahead = sparseocc_directions()[::360]
    azimuth = (torch.arange(azimuths, dtype=torch.float64) + 0.5) * (2 * math.pi / azimuths)
    level, up = torch.meshgrid(ahead[:, 0], azimuth, indexing="ij"), ahead[:, 2:].expand(-1, azimuths)
    return torch.stack([level[0] * level[1].cos(), level[0] * level[1].sin(), up], -1).reshape(-1, 3)


def eight_origins(positions_m: Float[Tensor, "F 3"], reach_m: float = 39.0, most: int = 8) -> Float[Tensor, "O 3"]:
    """Return the origins from which the public protocol casts the rays of one frame.

    Args:
        positions_m: positions of the LiDAR in all frames of the scene, past and future, in the ego frame of the scored
            frame, in order of time.
        reach_m: positions with |x| and |y| below this are used; z does not matter.
        most: largest number of origins. Of more positions, the first, the last and evenly spaced ones between them are
            taken, so that the position of the frame itself may be missing.

    Returns:
        At most `most` origins. Those of a standing car repeat, and each repetition counts.

    Example:
        >>> positions_m = torch.zeros(20, 3)
        >>> positions_m[:, 0] = torch.arange(20) * 5.0 - 50.0
        >>> eight_origins(positions_m)[:, 0].tolist()
        [-35.0, -25.0, -15.0, -5.0, 5.0, 15.0, 25.0, 35.0]
    """
    near = positions_m[(positions_m[:, :2].abs() < reach_m).all(dim=1)]
    if len(near) <= most:
        return near
    return near[torch.linspace(0, len(near) - 1, most, dtype=torch.float64).round().long().to(near.device)]
