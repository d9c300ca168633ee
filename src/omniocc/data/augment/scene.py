"""The same scene mirrored left to right, or seen with the car turned: images, cameras, labels and poses together.

Nothing is interpolated: cells go to cells, rays to rays, pixels to pixels.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.camera.models.mirrored import mirrored
from omniocc.geometry import Grid

LIDAR_AZIMUTHS = 360
"""Rays of every elevation of the ego LiDAR (`world.sensors.lidar.ego_directions`), counter-clockwise from ahead."""


class Change(NamedTuple):
    """First the flip, then the turn.

    Attributes:
        flip: y becomes -y in the ego frame, of the world as of the car.
        steps: the ego frame's content turns counter-clockwise by `steps / parts` of a full turn.
        parts: see `steps`.
    """

    flip: bool = False
    steps: int = 0
    parts: int = 1

    @property
    def turn(self) -> Tensor:
        """(4, 4) float64 rotation about z."""
        matrix = torch.eye(4, dtype=torch.float64)
        angle_rad = 2 * math.pi * self.steps / self.parts
        cos, sin = math.cos(angle_rad), math.sin(angle_rad)
        matrix[:2, :2] = torch.tensor([[cos, -sin], [sin, cos]], dtype=torch.float64)
        return matrix

    @property
    def mirror(self) -> Tensor:
        """(4, 4) float64 reflection of y, or identity."""
        return torch.diag(torch.tensor([1.0, -1.0 if self.flip else 1.0, 1.0, 1.0], dtype=torch.float64))

    def array(self, values: Tensor, dim: int, clockwise: bool = False) -> Tensor:
        """Values around the car, evenly spread over one turn along `dim`, whose middle or beginning is ahead."""
        if self.steps:
            shift = self.steps * values.shape[dim] // self.parts
            values = values.roll(-shift if clockwise else shift, dim)
        return values


def possible_turns(batch: Batch, geometry: Grid) -> int:
    """Into how many equal turns the circle divides so that each takes cells, rays and columns to one another."""
    (x_cells, y_cells, _), (x, y, _) = geometry.shape, geometry.bounds
    square = x_cells == y_cells and x == y and x[0] == -x[1]
    around = y_cells if geometry.periodic[1] else 4 if square else 1
    panoramas = [part.shape[-1] for part in (batch.erp_range_m, batch.depth_range_m) if part is not None]
    return math.gcd(around, LIDAR_AZIMUTHS, *panoramas)


def change_scenes(batch: Batch, geometry: Grid, changes: list[Change]) -> Batch:
    """Each sample changed in its own way.

    Raises:
        ValueError: if grid or LiDAR are not the same on both sides, or after the turn.
    """
    across = {"images": -1, "pixel_labels": -1, "camera_range_m": -1}
    content: dict[str, list[Tensor]] = {}
    for sample, change in enumerate(changes):
        for name, item in batch._asdict().items():
            if not isinstance(item, Tensor) or name == "exists":
                continue
            value = item[sample]
            if name in across:
                value = value.flip(-1) if change.flip else value
            elif name in ("voxels", "candidates"):
                value = change_cells(value, geometry, change)
            elif name in ("lidar_range_m", "lidar_labels"):
                value = change_rays(value, change)
            elif name in ("erp_range_m", "depth_range_m"):
                value = change.array(value.flip(-1) if change.flip else value, -1, clockwise=True)
            else:
                assert name == "world_from_ego"
                value = change_poses(value, change)
            content.setdefault(name, []).append(value)
    rigs = tuple(change_rig(rig, change) for rig, change in zip(batch.rigs, changes, strict=True))
    return batch._replace(rigs=rigs, **{name: torch.stack(parts) for name, parts in content.items()})


def change_poses(world_from_ego: Tensor, change: Change) -> Tensor:
    """Poses of the turned car in a world that is mirrored with it; proper rotations again."""
    mirror, turn = change.mirror.to(world_from_ego), change.turn.to(world_from_ego)
    return mirror @ world_from_ego @ mirror @ turn.T


def change_rays(values: Tensor, change: Change) -> Tensor:
    """(R,) values of the ego LiDAR's rays, elevation by elevation."""
    if change == Change():
        return values
    if len(values) % LIDAR_AZIMUTHS:
        raise ValueError(f"{len(values)} LiDAR rays are not {LIDAR_AZIMUTHS} per elevation; switch flips and turns off")
    rings = values.view(-1, LIDAR_AZIMUTHS)
    rings = rings.flip(-1).roll(1, -1) if change.flip else rings  # azimuth 0 stays
    return change.array(rings, -1).reshape(-1)


def change_cells(values: Tensor, geometry: Grid, change: Change) -> Tensor:
    """(..., *shape) values of cells, where the cells go."""
    if change == Change():
        return values
    return values.flatten(-3)[..., cell_sources(geometry, change).to(values.device)].view_as(values)


@lru_cache(maxsize=256)
def cell_sources(geometry: Grid, change: Change) -> Tensor:
    """(cells,) for every cell, the one whose content comes there; row-major numbers.

    Raises:
        ValueError: if the change does not take every cell centre to another cell's centre.
    """
    to_old = (change.turn @ change.mirror).T[:3, :3]
    centers_m = geometry.centers(torch.float64).reshape(-1, 3)
    wanted_m = centers_m @ to_old.T
    sources, inside = geometry.flat_index(wanted_m)
    if not inside.all() or float((centers_m[sources] - wanted_m).abs().max()) > 1e-6:
        raise ValueError(f"{geometry} is not symmetric under {change}; switch flips or turns off, or centre the grid")
    return sources


@lru_cache(maxsize=256)
def change_rig(rig: Rig, change: Change) -> Rig:
    """Cameras and their poses; a flip shows every image left to right."""
    if change == Change():
        return rig
    swap = torch.diag(torch.tensor([-1.0 if change.flip else 1.0, 1.0, 1.0, 1.0], dtype=torch.float64))
    ego_from_camera = change.turn @ change.mirror @ rig.ego_from_camera @ swap + 0.0
    cameras, masks = rig.cameras, rig.masks
    if change.flip:
        cameras = tuple(mirrored(camera) for camera in cameras)
        masks = masks and tuple(None if mask is None else mask.flip(-1) for mask in masks)
    return Rig(cameras, ego_from_camera, rig.names, masks)
