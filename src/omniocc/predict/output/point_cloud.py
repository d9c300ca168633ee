"""Coloured point clouds of panoramas of range."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, UInt8
from torch import Tensor
from torch.nn import functional as F

from omniocc.camera import Camera, Equirectangular, Rig, normalize_pixels
from omniocc.predict.output.ply import ply_bytes


class Cloud(NamedTuple):
    """What every pixel of a panorama sees.

    Attributes:
        points_m: in the ego frame, nan where there is no answer.
        colors: RGB, 0 where there is no answer.
    """

    points_m: Float64[Tensor, "h w 3"]
    colors: UInt8[Tensor, "h w 3"]


def cloud_of(range_m: Float[Tensor, "h w"], panorama: Equirectangular, images: Sequence[np.ndarray], rig: Rig) -> Cloud:
    """Points and their colours.

    Args:
        range_m: around the ego origin, not finite where there is no answer.
        panorama: directions of its pixels.
        images: (H, W, 3) uint8 RGB of every camera, of any size.
        rig: the cameras.
    """
    points = range_m.double().unsqueeze(-1) * panorama.rays().double()
    points = points.masked_fill(~range_m.isfinite().unsqueeze(-1), torch.nan)
    known = range_m.isfinite()
    colors = torch.zeros(*range_m.shape, 3, dtype=torch.uint8)
    colors[known] = point_colors(points[known], images, rig)[0]
    return Cloud(points, colors)


def point_colors(
    points_m: Float64[Tensor, "P 3"], images: Sequence[np.ndarray], rig: Rig
) -> tuple[UInt8[Tensor, "P 3"], Bool[Tensor, " P"]]:
    """RGB of points, each from the camera that sees it nearest to its axis, and whether any camera does.

    What stands between camera and point is not looked for. Black pictures do not count as seeing.
    """
    pixels, valid = rig.project(points_m)
    to_camera = points_m - rig.ego_from_camera[:, None, :3, 3]
    cosine = F.cosine_similarity(to_camera, rig.ego_from_camera[:, None, :3, 2], dim=-1)
    awake = torch.tensor([bool(image.any()) for image in images])
    cosine = torch.where(valid & awake[:, None], cosine, -torch.inf)
    best = cosine.argmax(0)
    colors = torch.zeros(len(points_m), 3, dtype=torch.uint8)
    for k, image in enumerate(images):
        mine = (best == k) & cosine[k].isfinite()
        colors[mine] = _sampled(image, pixels[k][mine], rig.cameras[k])
    return colors, cosine.amax(0).isfinite()


def _sampled(image: np.ndarray, pixels: Float64[Tensor, "P 2"], camera: Camera) -> UInt8[Tensor, "P 3"]:
    places = normalize_pixels(pixels, camera.width, camera.height)[None, None]
    picture = torch.from_numpy(image).permute(2, 0, 1)[None].double()
    values = F.grid_sample(picture, places, mode="bilinear", padding_mode="border", align_corners=False)
    return values[0, :, 0].T.round().clamp(0, 255).to(torch.uint8)


def write_ply(path: Path, cloud: Cloud) -> int:
    """Writes the known points as a binary PLY file, little endian, with float coordinates in metres and uchar colours.

    Returns:
        how many points there are.

    Raises:
        OSError: naming the path that cannot be written.
    """
    known = cloud.points_m.isfinite().all(-1)
    points = cloud.points_m[known].numpy()
    path.write_bytes(ply_bytes(points, cloud.colors[known].numpy()))
    return len(points)
