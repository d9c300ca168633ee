"""Voxels as seen from the cameras and from the ego origin."""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.ops.pixels import pixel_centers, usable
from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.draw.canvas import Images, Labels, fitted
from omniocc.geometry import Grid
from rayiou.raycast.fans import RayFans
from rayiou.raycast.table import RayTable

COARSE = 2
"""Side in pixels of the squares that are drawn from one ray."""

EDGE = 0.72
"""Brightness of pixels at the edges of voxels, relative to their inside."""

BACKGROUND = (225, 233, 242)
"""Colour of directions without a voxel."""


class View(NamedTuple):
    """Rays of one image, prepared for any labels.

    Attributes:
        valid: pixels that have a ray.
        table: their rays, in row-major order.
    """

    valid: Bool[Tensor, "h w"]
    table: RayTable


def paint_voxels(
    images: Images, rig: Rig, labels: Labels, geometry: Grid, classes: ClassTable, width: int
) -> list[np.ndarray]:
    """Return the camera images, scaled to a width, with the first voxel along every pixel's ray in its class colour.

    The brightness is that of the image, so that objects stay visible; pixels without a voxel are dim and grey.
    """
    painted = []
    for k, image in enumerate(images):
        scaled = fitted(image, width)
        view = camera_view(geometry, rig, k, scaled.shape[1] // COARSE, scaled.shape[0] // COARSE)
        colors, hit = _colors(view, labels, classes.palette)
        size = scaled.shape[1], scaled.shape[0]
        parts = (cv2.resize(part.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) for part in (colors, hit))
        painted.append(_blended(scaled, *parts))
    return painted


def voxel_panorama(
    labels: Labels, geometry: Grid, classes: ClassTable, panorama: Equirectangular, width: int
) -> np.ndarray:
    """Return an image, about width / 2 wide, of the first voxel in every direction from the ego origin."""
    columns = width // COARSE
    rows = round(columns * panorama.height / panorama.width)
    colors, hit = _colors(panorama_view(geometry, panorama, columns, rows), labels, classes.palette)
    colors[~hit] = BACKGROUND
    return colors


@lru_cache(maxsize=32)
def camera_view(geometry: Grid, rig: Rig, camera: int, columns: int, rows: int) -> View:
    """Return rays through the centres of `columns` x `rows` equal parts of a camera's image."""
    pose, (rays, seen) = rig.ego_from_camera[camera], rays_of_parts(rig, camera, columns, rows)
    return _view(geometry, pose[:3, 3], rays @ pose[:3, :3].T, seen)


def rays_of_parts(
    rig: Rig, camera: int, columns: int, rows: int
) -> tuple[Float64[Tensor, "rows columns 3"], Bool[Tensor, "rows columns"]]:
    """Return unit rays, camera frame, through the centres of equal parts of an image; and where lens and mask see."""
    model = rig.cameras[camera]
    size, parts = torch.tensor([model.width, model.height]), torch.tensor([columns, rows])
    pixels = (pixel_centers(columns, rows, torch.float64) + 0.5) * size / parts - 0.5
    rays, valid = model.unproject(pixels)
    return rays, usable(rig.each_mask[camera], pixels, valid)


@lru_cache(maxsize=4)
def panorama_view(geometry: Grid, panorama: Equirectangular, columns: int, rows: int) -> View:
    """Return rays from the ego origin in the directions of a panorama of another resolution."""
    rays = panorama.resized(columns, rows).rays().double()
    return _view(geometry, torch.zeros(3, dtype=torch.float64), rays, torch.ones(rays.shape[:2], dtype=torch.bool))


def _view(geometry: Grid, origin: Float[Tensor, "3"], rays: Float[Tensor, "h w 3"], valid: Bool[Tensor, "h w"]) -> View:
    directions = rays[valid]
    return View(valid, RayTable(geometry, RayFans.from_rays(origin.expand_as(directions), directions)))


def _colors(view: View, labels: Labels, palette: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return class colours (h, w, 3), darker at the edges of voxels, and whether a voxel is hit (h, w)."""
    hits = view.table.cast(labels.masked_fill(labels == UNKNOWN, FREE))
    cells = torch.full(view.valid.shape, -1, dtype=torch.int32)
    found = torch.zeros(view.valid.shape, dtype=torch.uint8)
    cells[view.valid], found[view.valid] = hits.cells, hits.labels
    edge = torch.zeros_like(view.valid)
    edge[:-1] |= cells[:-1] != cells[1:]
    edge[:, :-1] |= cells[:, :-1] != cells[:, 1:]
    colors = palette[found.numpy()]
    colors[edge.numpy()] = (colors[edge.numpy()] * EDGE).astype(np.uint8)
    return colors, found.numpy() != FREE


def _blended(scaled: np.ndarray, colors: np.ndarray, hit: np.ndarray) -> np.ndarray:
    grey = cv2.cvtColor(scaled, cv2.COLOR_RGB2GRAY)[..., None]
    lit = colors * (0.45 + 0.75 * grey / 255) * 0.7 + 0.3 * scaled
    return np.where(hit[..., None] > 0, lit, 0.6 * grey).clip(0, 255).astype(np.uint8)
