"""Files of predicted ranges: range panoramas (PNG, NPZ) and coloured point clouds (PLY)."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, UInt8
from torch import Tensor
from torch.nn import functional as F

from omniocc.camera import Camera, Equirectangular, Rig, normalize_pixels
from omniocc.data.store.codec import quantize_range
from omniocc.draw import save_png
from omniocc.io import atomic_write
from omniocc.model.depth import DepthMap

RANGES, POINTS, OVERVIEW = "range.npz", "points.ply", "overview.png"

VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", (3,))])
_PLY_TYPES = {"f4": "float", "u1": "uchar"}


def ply_bytes(points_m: np.ndarray, colors: np.ndarray, triangles: np.ndarray | None = None) -> bytes:
    """Return the content of a binary PLY file of points or of a mesh; coordinates are floats, colours are bytes.

    Args:
        points_m: (V, 3), ego frame, m.
        colors: (V, 3) uint8, RGB.
        triangles: (T, 3) indices into `points_m`; None: a point cloud without faces.
    """
    vertices = np.empty(len(points_m), VERTEX)
    for k, name in enumerate("xyz"):
        vertices[name] = points_m[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        vertices[name] = colors[:, k]
    fields = [f"property {_PLY_TYPES[VERTEX[name].str[1:]]} {name}" for name in VERTEX.names or ()]
    header = ["ply", "format binary_little_endian 1.0", "comment ego frame: x forward, y left, z up; metres"]
    header += [f"element vertex {len(vertices)}", *fields]
    body = vertices.tobytes()
    if triangles is not None:
        faces = np.empty(len(triangles), TRIANGLE)
        faces["count"], faces["corners"] = 3, triangles
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        body += faces.tobytes()
    return "\n".join([*header, "end_header", ""]).encode("ascii") + body


class PointCloud(NamedTuple):
    """The point that every pixel of a panorama sees, and its colour.

    Attributes:
        points_m: points in the ego frame, m; nan where no range is predicted.
        colors: RGB, 0 where no range is predicted or no camera sees the point.
    """

    points_m: Float64[Tensor, "h w 3"]
    colors: UInt8[Tensor, "h w 3"]


def point_cloud(
    range_m: Float[Tensor, "h w"], panorama: Equirectangular, images: Sequence[np.ndarray], rig: Rig
) -> PointCloud:
    """Return the points of a range panorama and their colours.

    Args:
        range_m: range from the ego origin along the ray of each pixel, m; inf or nan: no range.
        panorama: camera model of the pixels.
        images: one image (H, W, 3) per camera, uint8 RGB, of any size.
        rig: cameras of the images.
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
    """Return the RGB of points in the ego frame, and whether any camera sees them.

    Of the cameras that see a point, the one with the smallest angle between optical axis and point gives the colour.
    Occlusion is ignored. A camera with an all-black image sees nothing. `images` are as in `point_cloud`.
    """
    pixels, valid = rig.project(points_m)
    to_camera = points_m - rig.ego_from_camera[:, None, :3, 3]
    cosine = F.cosine_similarity(to_camera, rig.ego_from_camera[:, None, :3, 2], dim=-1)
    has_image = torch.tensor([bool(image.any()) for image in images])
    cosine = torch.where(valid & has_image[:, None], cosine, -torch.inf)
    nearest = cosine.argmax(0)  # index of the camera; 0 too where no camera sees the point
    colors = torch.zeros(len(points_m), 3, dtype=torch.uint8)
    for k, image in enumerate(images):
        chosen = (nearest == k) & cosine[k].isfinite()
        colors[chosen] = _sample_colors(image, pixels[k][chosen], rig.cameras[k])
    return colors, cosine.amax(0).isfinite()


def _sample_colors(image: np.ndarray, pixels: Float64[Tensor, "P 2"], camera: Camera) -> UInt8[Tensor, "P 3"]:
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


def write_depth(
    folder: Path, depth: DepthMap, panorama: Equirectangular, cloud: PointCloud, overview: np.ndarray
) -> int:
    """Write `range.png`, `range.npz`, `points.ply` and `overview.png` of one frame; return the number of points.

    `range.png` has 16 bits per pixel in steps of 1/256 m, as KITTI's depth maps; 0: no range. `range.npz` holds float32
    arrays (height, width): `range_m`, m, nan: no range; and `confidence`. It also holds the panorama's edges, `top_deg`
    and `bottom_deg`. The folder is created if it is missing.

    Args:
        folder: folder of the files.
        depth: predicted ranges; the first of the batch is written.
        panorama: camera model of the pixels.
        cloud: points of `points.ply`.
        overview: image (H, W, 3), uint8 RGB.

    Raises:
        DataError: naming the path that cannot be written.
    """
    range_m = depth.known_range_m()[0]
    _, data = cv2.imencode(".png", quantize_range(range_m.numpy()))
    atomic_write(folder / "range.png", data.tobytes())
    content = io.BytesIO()
    np.savez_compressed(
        content,
        range_m=range_m.numpy(),
        confidence=depth.confidence[0].float().numpy(),
        top_deg=panorama.top_deg,
        bottom_deg=panorama.bottom_deg,
    )
    atomic_write(folder / RANGES, content.getvalue())
    save_png(folder / OVERVIEW, overview)
    return write_ply(folder / POINTS, cloud)
