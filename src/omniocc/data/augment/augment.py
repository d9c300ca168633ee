"""Random changes of training batches, as the configuration chooses them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from omniocc.batch import Batch
from omniocc.bounds import Degrees
from omniocc.camera import Rig
from omniocc.camera.models.mirrored import mirrored
from omniocc.classes import UNKNOWN
from omniocc.data.augment.disturbances import Disturbances
from omniocc.data.augment.image import erase, jitter
from omniocc.errors import UserError
from omniocc.geometry import Grid

# fields of a batch that change in the same way
IMAGES = ("images", "pixel_labels", "camera_range_m")
CELLS = ("voxels", "candidates", "evidence")
PANORAMAS = ("erp_range_m", "depth_range_m")
VECTORS = ("lidar_directions", "lidar_origins", "scan_origins", "scan_ends")


class Change(NamedTuple):
    """A flip, then a turn.

    Attributes:
        flip: whether y becomes -y in the ego frame, for the scene and for the cameras.
        steps: the scene and the cameras turn counter-clockwise about z by `steps / parts` of a full turn.
        parts: number of equal steps of a full turn.
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

    def change_panoramas(self, values: Tensor) -> Tensor:
        """Return the panoramas (..., W) of the changed scene; columns run clockwise around the full circle."""
        values = values.flip(-1) if self.flip else values
        return values.roll(-self.steps * values.shape[-1] // self.parts, -1) if self.steps else values


def count_turns(batch: Batch, geometry: Grid) -> int:
    """Return the most equal steps of a full turn of which each takes cells to cells and columns to columns."""
    (x_cells, y_cells, _), (x, y, _) = geometry.shape, geometry.bounds
    square = x_cells == y_cells and x == y and x[0] == -x[1]
    around = y_cells if geometry.periodic[1] else 4 if square else 1
    panoramas = [part.shape[-1] for part in (batch.erp_range_m, batch.depth_range_m) if part is not None]
    return math.gcd(around, *panoramas)


def change_scenes(batch: Batch, geometry: Grid, changes: list[Change]) -> Batch:
    """Mirror and turn each sample as `changes` has it: images, cameras, labels and poses together.

    Nothing is interpolated: cells go to cells, pixels to pixels.

    LiDAR rays turn with the scene if the batch holds them. The fixed rays of a source cannot turn, so their ranges and
    labels are removed, as are the voxels on the dataset's own grid; no loss uses them.

    Raises:
        UserError: if a change does not take every cell of the grid to another cell.
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
        return change.change_panoramas(value)
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
    ego_from_camera = change.turn @ change.mirror @ rig.ego_from_camera @ swap + 0.0  # makes -0.0 to 0.0
    cameras, masks = rig.cameras, rig.masks
    if change.flip:
        cameras = tuple(mirrored(camera) for camera in cameras)
        masks = masks and tuple(None if mask is None else mask.flip(-1) for mask in masks)
    return replace(rig, cameras=cameras, ego_from_camera=ego_from_camera, masks=masks)


class Augment:
    """Erased boxes, other colours, mirrored and turned scenes, shorter histories; 0 switches each off.

    Erasing is the paper's ('random cropping on the input RGB images to enhance robustness against occlusion'). Labels
    of voxels stay, since the space behind an erased box can be inferred from other cameras, other frames and the
    surroundings. Labels of erased pixels become 255.

    Args:
        geometry: grid of the voxel labels.
        erase_probability: that an image loses a box.
        erase_fraction: smallest and largest area of a box, as a fraction of the image's.
        erase_aspect: smallest and largest width / height of a box.
        brightness: largest relative change, of every camera of every sample.
        contrast: largest relative change, of every camera of every sample.
        saturation: largest relative change, of every camera of every sample.
        hue_deg: largest turn of the colour circle, degrees.
        flip_probability: that a scene is mirrored left to right.
        yaw_probability: that a scene is turned about the vertical axis, by any step that takes cells to cells.
        drop_past_probability: that a past frame counts as not recorded, which saves its cost.
        disturbances: what is wrong in some batches, before all other changes; None: nothing.

    Raises:
        ValueError: for a value that is no probability or fraction, or an empty range.
    """

    def __init__(
        self,
        geometry: Grid,
        erase_probability: float,
        erase_fraction: Sequence[float],
        erase_aspect: Sequence[float],
        brightness: float,
        contrast: float,
        saturation: float,
        hue_deg: Degrees,
        flip_probability: float,
        yaw_probability: float,
        drop_past_probability: float,
        disturbances: Disturbances | None = None,
    ):
        fractions = {
            "erase_probability": erase_probability,
            "flip_probability": flip_probability,
            "yaw_probability": yaw_probability,
            "drop_past_probability": drop_past_probability,
            "brightness": brightness,
            "contrast": contrast,
            "saturation": saturation,
        }
        for name, value in fractions.items():
            if not 0 <= value <= 1:
                raise ValueError(f"{name} is {value}; it must be from 0 (off) to 1")
        for name, pair, most in (("erase_fraction", erase_fraction, 1.0), ("erase_aspect", erase_aspect, float("inf"))):
            if len(pair) != 2 or not 0 < pair[0] <= pair[1] <= most:
                raise ValueError(f"{name} is {list(pair)}; it must be [smallest, largest], above 0 and at most {most}")
        self.geometry = geometry
        self.erasing = (erase_probability, tuple(erase_fraction), tuple(erase_aspect))
        self.colors = (brightness, contrast, saturation, hue_deg)
        self.flip_probability, self.yaw_probability = flip_probability, yaw_probability
        self.drop_past_probability = drop_past_probability
        self.disturbances = disturbances

    def __call__(self, batch: Batch, generator: torch.Generator) -> Batch:
        """Return a changed batch, which depends on the state of `generator` (on the CPU), not on the batch's device."""
        if self.disturbances is not None:  # first: focal lengths of mirrored cameras cannot be changed
            batch = self.disturbances(batch, generator)
        if self.flip_probability or self.yaw_probability:
            batch = change_scenes(batch, self.geometry, self._draw_changes(batch, generator))
        if self.drop_past_probability:
            batch = drop_past(batch, self.drop_past_probability, generator)
        images = batch.images
        if any(self.colors):
            mask = batch.image_mask()
            images = jitter(images, *self.colors, generator, None if bool(mask.all()) else mask)
        if self.erasing[0]:
            images, erased = erase(images, *self.erasing, generator, batch.image_sizes())
            if batch.pixel_labels is not None:  # of the newest frame
                batch = batch._replace(pixel_labels=batch.pixel_labels.masked_fill(erased[:, -1], UNKNOWN))
        return batch._replace(images=images)

    def _draw_changes(self, batch: Batch, generator: torch.Generator) -> list[Change]:
        parts = count_turns(batch, self.geometry)
        size = len(batch.frame_ids)
        flips = torch.rand(size, generator=generator) < self.flip_probability
        turns = torch.rand(size, generator=generator) < self.yaw_probability
        steps = torch.randint(0, parts, (size,), generator=generator) * turns
        draws = zip(flips.tolist(), steps.tolist(), strict=True)
        return [Change(flip, step, parts if step else 1) for flip, step in draws]


def drop_past(batch: Batch, probability: float, generator: torch.Generator) -> Batch:
    """Return windows in which each past frame counts as missing with this probability; the newest always stays."""
    kept = torch.rand(batch.images.shape[:2], generator=generator) >= probability
    kept[:, -1] = True
    kept = kept.to(batch.images.device)
    return batch._replace(exists=kept if batch.exists is None else batch.exists & kept)
