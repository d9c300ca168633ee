"""Coloured point clouds of range panoramas."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, UInt8
from torch import Tensor
from torch.nn import functional as F

from omniocc.camera import Camera, Equirectangular, Rig, normalize_pixels
from omniocc.io import atomic_write
from omniocc.predict.output.ply import ply_bytes


class PointCloud(NamedTuple):
    """The point and colour that every pixel of a panorama sees.

    Attributes:
        points_m: in the ego frame, nan where no range is predicted.
        colors: RGB, 0 where no range is predicted.
    """

    points_m: Float64[Tensor, "h w 3"]
    colors: UInt8[Tensor, "h w 3"]


def point_cloud(
    range_m: Float[Tensor, "h w"], panorama: Equirectangular, images: Sequence[np.ndarray], rig: Rig
) -> PointCloud:
    """Return the points of a range panorama and their colours.

    `range_m` is the range from the ego origin in the directions of `panorama`, not finite where none is known;
    `images` are (H, W, 3) uint8 RGB of every camera, of any size.
    """
    points = range_m.double().unsqueeze(-1) * panorama.rays().double()
    known = range_m.isfinite()
    points = points.masked_fill(~known.unsqueeze(-1), torch.nan)
    colors = torch.zeros(*range_m.shape, 3, dtype=torch.uint8)
    colors[known] = point_colors(points[known], images, rig)[0]
    return PointCloud(points, colors)


def point_colors(
    points_m: Float64[Tensor, "P 3"], images: Sequence[np.ndarray], rig: Rig
) -> tuple[UInt8[Tensor, "P 3"], Bool[Tensor, " P"]]:
    """Return the RGB of points, given in the ego frame, and whether any camera sees them.

    The colour comes from the camera that sees the point nearest to its optical axis. Occlusion is ignored; cameras with
    a black image see nothing. `images` are as in `point_cloud`.
    """
    pixels, valid = rig.project(points_m)
    to_camera = points_m - rig.ego_from_camera[:, None, :3, 3]
    cosine = F.cosine_similarity(to_camera, rig.ego_from_camera[:, None, :3, 2], dim=-1)
    active = torch.tensor([bool(image.any()) for image in images])
    cosine = torch.where(valid & active[:, None], cosine, -torch.inf)
    best = cosine.argmax(0)
    colors = torch.zeros(len(points_m), 3, dtype=torch.uint8)
    for k, image in enumerate(images):
        own = (best == k) & cosine[k].isfinite()
        colors[own] = _sampled(image, pixels[k][own], rig.cameras[k])
    return colors, cosine.amax(0).isfinite()


def _sampled(image: np.ndarray, pixels: Float64[Tensor, "P 2"], camera: Camera) -> UInt8[Tensor, "P 3"]:
    grid = normalize_pixels(pixels, camera.width, camera.height)[None, None]
    source = torch.from_numpy(image).permute(2, 0, 1)[None].double()
    values = F.grid_sample(source, grid, mode="bilinear", padding_mode="border", align_corners=False)
    return values[0, :, 0].T.round().clamp(0, 255).to(torch.uint8)


def write_ply(path: Path, cloud: PointCloud) -> int:
    """Write the finite points as a PLY file (see `ply_bytes`) and return their number.

    Raises:
        DataError: naming the path that cannot be written.
    """
    known = cloud.points_m.isfinite().all(-1)
    points = cloud.points_m[known].numpy()
    atomic_write(path, ply_bytes(points, cloud.colors[known].numpy()))
    return len(points)
