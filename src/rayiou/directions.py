"""Directions and origins of the LiDAR rays of the public RayIoU."""

import math
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from rayiou.lattice import Lattice

MARGIN_M = 1.0
"""Origins must be more than this far inside of a grid's sides. The public rule is 39 m, in a grid that ends at 40 m."""
MOST_ORIGINS = 8


class RayOrigins(NamedTuple):
    """Where the rays of one scored frame start.

    Attributes:
        positions_m: ego frame of the scored frame, m.
        times: number of frames from the scored frame to that of each origin; negative in the past, positive in the
            future.
    """

    positions_m: Float[Tensor, "O 3"]
    times: Int64[Tensor, " O"]


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
    """Return unit directions at the public RayIoU's 39 elevations and other azimuths, the first half a step off +x."""
    at_azimuth_0 = sparseocc_directions()[::360]
    azimuth = (torch.arange(azimuths, dtype=torch.float64) + 0.5) * (2 * math.pi / azimuths)
    horizontal, azimuth = torch.meshgrid(at_azimuth_0[:, 0], azimuth, indexing="ij")
    up = at_azimuth_0[:, 2:].expand(-1, azimuths)
    return torch.stack([horizontal * azimuth.cos(), horizontal * azimuth.sin(), up], -1).reshape(-1, 3)


def sparseocc_origins(
    positions_m: Float[Tensor, "F 3"], reach_m: float = 39.0, most: int = MOST_ORIGINS
) -> Float[Tensor, "O 3"]:
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
        >>> sparseocc_origins(positions_m)[:, 0].tolist()
        [-35.0, -25.0, -15.0, -5.0, 5.0, 15.0, 25.0, 35.0]
    """
    return positions_m[origin_frames(positions_m, reach_m, most)]


def origin_frames(
    positions_m: Float[Tensor, "F 3"], reach_m: float = 39.0, most: int = MOST_ORIGINS
) -> Int64[Tensor, " O"]:
    """Return the numbers of the frames whose positions `sparseocc_origins` returns."""
    return thin_frames((positions_m[:, :2].abs() < reach_m).all(dim=1).nonzero().flatten(), most)


def thin_frames(frames: Int64[Tensor, " F"], most: int) -> Int64[Tensor, " O"]:
    """Return all frames if they are at most `most`, else the first, the last and evenly spaced ones between them."""
    if len(frames) <= most:
        return frames
    return frames[torch.linspace(0, len(frames) - 1, most, dtype=torch.float64).round().long().to(frames.device)]


def trajectory_origins(
    world_from_ego: Float[Tensor, "*poses"] | np.ndarray,
    frame: int,
    grid: Lattice,
    ego_from_sensor: Float[Tensor, "*sensor_poses"] | np.ndarray | None = None,
    most: int = MOST_ORIGINS,
) -> RayOrigins:
    """Return where the car was before, at and after a frame, as origins of its rays: the rule of the public RayIoU.

    SparseOcc (Liu et al. 2024; `EgoPoseDataset` in `loaders/ego_pose_dataset.py` of its repository) casts the rays of a
    frame from the positions of the LiDAR in all key frames of the scene, past and future ones, in the ego frame of the
    scored frame. Used are those more than 1 m inside of the grid's sides, whatever their height. Of more than
    eight, the first, the last and six evenly spaced by their number between them are taken
    (`round(linspace(0, n - 1, 8))`), so that the frame's own position may be missing. Here the frame's own position is
    one of those to choose from even where it is at a side of the grid, as the car's is in a grid that lies ahead of it.

    Args:
        world_from_ego: (F, 4, 4) poses of all frames of the scene, in order of time, float64.
        frame: number of the scored frame.
        grid: grid of the scored voxels.
        ego_from_sensor: (F, 4, 4) or (4, 4) pose of the LiDAR in the ego frame of each frame; default: at its origin.
        most: largest number of origins.

    Returns:
        In float64: at most `most` origins, in order of time. Those of a standing car repeat, and each counts.

    Raises:
        ValueError: if a shape is wrong or there is no such frame.

    Example:
        >>> from rayiou import Cylinder
        >>> poses = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
        >>> poses[:, 0, 3] = torch.arange(5) * 10.0  # 10 m ahead from frame to frame
        >>> origins = trajectory_origins(poses, 1, Cylinder())
        >>> origins.positions_m[:, 0].tolist(), origins.times.tolist()
        ([-10.0, 0.0, 10.0, 20.0], [-1, 0, 1, 2])
    """
    poses = torch.as_tensor(world_from_ego).double()
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not 0 <= frame < len(poses):
        raise ValueError(f"frame {frame} of poses (F, 4, 4), got shape {tuple(poses.shape)}")
    sensor = torch.eye(4, dtype=torch.float64) if ego_from_sensor is None else torch.as_tensor(ego_from_sensor).double()
    if sensor.shape not in ((4, 4), poses.shape):
        raise ValueError(f"ego_from_sensor must have shape {tuple(poses.shape)}, got {tuple(sensor.shape)}")
    rotation, translation = poses[frame, :3, :3], poses[frame, :3, 3]
    positions_m = ((poses @ sensor)[:, :3, 3] - translation) @ rotation
    usable = grid.within_sides(positions_m, MARGIN_M)
    usable[frame] = True
    frames = thin_frames(usable.nonzero().flatten(), most)
    return RayOrigins(positions_m[frames], frames - frame)
