"""Mirror a scene left to right, or turn the car in it: images, cameras, labels and poses together.

Nothing is interpolated: cells go to cells, pixels to pixels.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.camera.models.mirrored import mirrored
from omniocc.errors import UserError
from omniocc.geometry import Grid

IMAGES = ("images", "pixel_labels", "camera_range_m")
CELLS = ("voxels", "candidates", "evidence")
PANORAMAS = ("erp_range_m", "depth_range_m")
VECTORS = ("lidar_directions", "lidar_origins")


class Change(NamedTuple):
    """A flip, then a turn.

    Attributes:
        flip: y becomes -y in the ego frame, for the world and for the car.
        steps: the ego frame's content turns counter-clockwise by `steps / parts` of a full turn.
        parts: equal steps of a full turn.
    """

    flip: bool = False
    steps: int = 0
    parts: int = 1

    @property
    def turn(self) -> Tensor:
        """Return the rotation about z, (4, 4) float64."""
        matrix = torch.eye(4, dtype=torch.float64)
        angle_rad = 2 * math.pi * self.steps / self.parts
        cos, sin = math.cos(angle_rad), math.sin(angle_rad)
        matrix[:2, :2] = torch.tensor([[cos, -sin], [sin, cos]], dtype=torch.float64)
        return matrix

    @property
    def mirror(self) -> Tensor:
        """Return the reflection of y, (4, 4) float64; without a flip the identity."""
        return torch.diag(torch.tensor([1.0, -1.0 if self.flip else 1.0, 1.0, 1.0], dtype=torch.float64))

    def columns(self, values: Tensor) -> Tensor:
        """Return panoramas (..., W) of the changed scene; their columns run clockwise around the full circle."""
        values = values.flip(-1) if self.flip else values
        return values.roll(-self.steps * values.shape[-1] // self.parts, -1) if self.steps else values


def possible_turns(batch: Batch, geometry: Grid) -> int:
    """Return the number of equal turns of a circle of which each takes cells to cells and columns to columns."""
    (x_cells, y_cells, _), (x, y, _) = geometry.shape, geometry.bounds
    square = x_cells == y_cells and x == y and x[0] == -x[1]
    around = y_cells if geometry.periodic[1] else 4 if square else 1
    panoramas = [part.shape[-1] for part in (batch.erp_range_m, batch.depth_range_m) if part is not None]
    return math.gcd(around, *panoramas)


def change_scenes(batch: Batch, geometry: Grid, changes: list[Change]) -> Batch:
    """Change each sample in its own way.

    LiDAR rays turn with the scene if the batch holds them. The fixed rays of a source cannot turn, so their ranges and
    labels are removed, as are the voxels on the dataset's own grid; no loss uses them.

    Raises:
        ValueError: if the grid is not the same on both sides, or after the turn.
    """
    batch = batch._replace(own_voxels=None, scored=None, ray_origins=None, ray_times=None)
    if batch.lidar_directions is None:
        batch = batch._replace(lidar_range_m=None, lidar_labels=None, lidar_moving=None)
    widths = batch.image_sizes()[0]
    changed = {}
    for name in (*IMAGES, *CELLS, *PANORAMAS, *VECTORS, "world_from_ego"):
        values = getattr(batch, name)
        if values is not None:
            parts = zip(values, changes, widths, strict=True)
            changed[name] = torch.stack([change_field(name, *part, geometry) for part in parts])
    pairs = zip(batch.rigs, changes, strict=True)
    rigs = tuple(tuple(change_rig(rig, change) for rig in frames) for frames, change in pairs)
    return batch._replace(rigs=rigs, **changed)


def change_field(name: str, value: Tensor, change: Change, widths: Tensor, geometry: Grid) -> Tensor:
    """Return the field `name` of one sample in the changed scene; `widths` (T, N) are those of the images, px."""
    if name in IMAGES:
        return mirror_columns(value, widths if name == "images" else widths[-1]) if change.flip else value
    if name in CELLS:
        return change_cells(value, geometry, change)
    if name in PANORAMAS:
        return change.columns(value)
    if name in VECTORS:
        return value @ (change.turn @ change.mirror)[:3, :3].T.to(value)
    return change_poses(value, change)


def mirror_columns(values: Tensor, widths: Tensor) -> Tensor:
    """Return images mirrored left to right, each within its own width.

    Args:
        values: (*S, ..., W), padded at the end of the last axis.
        widths: (*S) int64, px, on the CPU; 0 where there is no image.
    """
    width = values.shape[-1]
    if bool((widths == width).all()):
        return values.flip(-1)
    columns = torch.arange(width)
    sources = torch.where(columns < widths[..., None], widths[..., None] - 1 - columns, columns)
    sources = sources.reshape(*widths.shape, *[1] * (values.ndim - widths.ndim - 1), width)
    return values.gather(-1, sources.to(values.device).expand_as(values))


def change_poses(world_from_ego: Tensor, change: Change) -> Tensor:
    """Return the poses of the turned car in a world that is mirrored with it; they are proper rotations again."""
    mirror, turn = change.mirror.to(world_from_ego), change.turn.to(world_from_ego)
    return mirror @ world_from_ego @ mirror @ turn.T


def change_cells(values: Tensor, geometry: Grid, change: Change) -> Tensor:
    """Return the values of cells (..., *shape) at the cells' new places."""
    if change == Change():
        return values
    return values.flatten(-3)[..., cell_sources(geometry, change).to(values.device)].view_as(values)


@lru_cache(maxsize=256)
def cell_sources(geometry: Grid, change: Change) -> Tensor:
    """Return for every cell the row-major number of the cell from which its content comes, (cells,).

    Raises:
        UserError: if the change does not take every cell centre to another cell's centre.
    """
    to_old = (change.turn @ change.mirror).T[:3, :3]
    centers_m = geometry.centers(torch.float64).reshape(-1, 3)
    origins_m = centers_m @ to_old.T
    sources, inside = geometry.flat_index(origins_m)
    if not inside.all() or float((centers_m[sources] - origins_m).abs().max()) > 1e-6:
        raise UserError(f"{geometry} is not symmetric under {change}; switch flips or turns off, or centre the grid")
    return sources


@lru_cache(maxsize=256)
def change_rig(rig: Rig, change: Change) -> Rig:
    """Return the cameras and their poses after a change; a flip mirrors every image left to right."""
    if change == Change():
        return rig
    swap = torch.diag(torch.tensor([-1.0 if change.flip else 1.0, 1.0, 1.0, 1.0], dtype=torch.float64))
    ego_from_camera = change.turn @ change.mirror @ rig.ego_from_camera @ swap + 0.0
    cameras, masks = rig.cameras, rig.masks
    if change.flip:
        cameras = tuple(mirrored(camera) for camera in cameras)
        masks = masks and tuple(None if mask is None else mask.flip(-1) for mask in masks)
    return replace(rig, cameras=cameras, ego_from_camera=ego_from_camera, masks=masks)
