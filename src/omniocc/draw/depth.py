"""One sheet per frame of predicted ranges: on the camera images, and as a panorama beside the truth."""

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.draw.bev import EMPTY
from omniocc.draw.canvas import Images, Ranges, blank, draw_scale, fitted, legend
from omniocc.draw.ranges import (
    ERROR_LEGEND,
    NOT_PREDICTED,
    RANGE_LEGEND,
    UNKNOWN_RANGE,
    error_bar,
    error_colors,
    range_bar,
    range_colors,
)
from omniocc.draw.sheet import (
    NAMES,
    azimuths,
    camera_rows,
    column_width,
    elevations,
    inner_width,
    panorama_row,
    row,
    stack,
)

COVER = 1.8
"""Diameter of a point over the distance to its neighbour."""


def depth_sheet(
    images: Images,
    rig: Rig,
    panorama: Equirectangular,
    predicted_m: Ranges,
    true_m: Ranges,
    caption: str = "",
    width_px: int = 1280,
) -> np.ndarray:
    """Return the sheet as one image; `panorama` has the directions of the ranges, `caption` is the line at the top."""
    inner = inner_width(width_px)
    predicted, true = predicted_m.numpy(), true_m.numpy()
    both = np.isfinite(predicted) & np.isfinite(true)
    mean = f", {np.abs(predicted[both] - true[both]).mean():.2f} m on average" if both.any() else ""
    rows = [
        *painted_rows(images, rig, panorama, predicted_m, inner),
        panorama_row(range_colors(true), "true range", inner),
        panorama_row(range_colors(predicted), "predicted range", inner),
        range_bar(inner),
        legend(RANGE_LEGEND, inner),
        panorama_row(error_colors(predicted, true), f"error: predicted minus true{mean}", inner),
        azimuths(inner),
        error_bar(inner),
        legend(ERROR_LEGEND, inner),
    ]
    return stack(rows, width_px, caption)


def painted_rows(images: Images, rig: Rig, panorama: Equirectangular, range_m: Ranges, width: int) -> list[np.ndarray]:
    """Return rows of camera images with the points of a panorama on them, as `paint_ranges` draws them."""
    columns = 3 if len(images) % 3 == 0 else 2
    painted = paint_ranges(images, rig, panorama, range_m, column_width(width, columns))
    return camera_rows(painted, width, columns, None if len(rig.names) == len(NAMES) else rig.names)


def paint_ranges(images: Images, rig: Rig, panorama: Equirectangular, range_m: Ranges, width: int) -> list[np.ndarray]:
    """Return the camera images, scaled to a width, with the points of a panorama in the colours of their range.

    A point is as large as the panorama's pixel appears from the camera, and nearer points hide farther ones. The
    brightness is that of the image, so that objects stay visible. Ranges that are not finite are not drawn.
    """
    known = range_m.isfinite().flatten()
    points = (range_m.unsqueeze(-1) * panorama.rays()).flatten(0, 1)[known].double()
    order = points.norm(dim=-1).argsort(descending=True)
    pixels, valid = rig.project(points[order])
    colors = range_colors(range_m.flatten()[known][order].numpy())
    step_rad = 2 * np.pi / panorama.width
    painted = []
    for k, image in enumerate(images):
        camera = fitted(image, width)
        scale = width / rig.cameras[k].width
        from_camera = (points[order] - rig.ego_from_camera[k, :3, 3]).norm(dim=-1).clamp(min=1e-3)
        extent_rad = step_rad * points[order].norm(dim=-1) / from_camera
        radius = extent_rad * _pixels_per_rad(rig, k) * scale * COVER / 2
        inside = valid[k]
        places = (pixels[k][inside] + 0.5) * scale - 0.5
        painted.append(_dotted(camera, places.numpy(), radius[inside].clamp(1, 12).numpy(), colors[inside.numpy()]))
    return painted


def _pixels_per_rad(rig: Rig, k: int) -> float:
    """Return the mean number of pixels per radian over the width of the image."""
    camera = rig.cameras[k]
    row = torch.stack([torch.linspace(0, camera.width - 1, 65), torch.full((65,), camera.height / 2)], -1).double()
    rays, valid = camera.unproject(row)
    both = valid[1:] & valid[:-1]
    angles = torch.linalg.vector_norm(rays[1:] - rays[:-1], dim=-1)[both]
    return float((camera.width - 1) / 64 / angles.mean()) if bool(both.any()) else float(camera.width)


def _dotted(image: np.ndarray, places: np.ndarray, radius: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Return the grey image with discs drawn in this order, lit by its brightness."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    paint = np.repeat((grey * 0.6).astype(np.uint8)[..., None], 3, axis=2)
    drawn = np.zeros(grey.shape, np.uint8)
    fixed, sizes = np.round(places * 16).astype(int).tolist(), np.round(radius * 16).astype(int).tolist()
    for center, size, rgb in zip(fixed, sizes, colors.tolist(), strict=True):
        cv2.circle(paint, center, size, rgb, -1, cv2.LINE_8, shift=4)
        cv2.circle(drawn, center, size, 1, -1, cv2.LINE_8, shift=4)
    light = 0.45 + 0.75 * (grey / 255.0)
    lit = (paint * light[..., None]).clip(0, 255).astype(np.uint8)
    return np.where(drawn[..., None] > 0, lit, paint)


def predicted_sheet(
    images: Images,
    rig: Rig,
    panorama: Equirectangular,
    range_m: Ranges,
    colors: UInt8[Tensor, "h w 3"],
    caption: str = "",
    half_m: float = 12.0,
    width_px: int = 1280,
) -> np.ndarray:
    """Return the sheet: ranges on the images, the images as one panorama at these ranges, ranges, points from above.

    `panorama` has the directions of the ranges, `colors` are the RGB of their points, `caption` is the line at the top.
    The views from above reach `half_m` from their middle to their edges.
    """
    inner = inner_width(width_px)
    half = column_width(inner, 2)
    known = range_m.isfinite()
    points = (range_m.unsqueeze(-1) * panorama.rays())[known].numpy()
    shown = [colors[known].numpy(), range_colors(np.linalg.norm(points, axis=1))]
    above = [from_above(points, part, half_m, half) for part in shown]
    warped = np.where(known.numpy()[..., None], colors.numpy(), np.array(NOT_PREDICTED, np.uint8))
    rows = [
        *painted_rows(images, rig, panorama, range_m, inner),
        panorama_row(warped, "images at these ranges", inner),
        panorama_row(range_colors(range_m.numpy()), f"range, {elevations(panorama)}", inner),
        azimuths(inner),
        range_bar(inner),
        legend([UNKNOWN_RANGE, ("a range, but no camera sees its point", (0, 0, 0))], inner),
        row(above, (f"points from above, {2 * half_m:g} m across", "their range"), inner),
    ]
    return stack(rows, width_px, caption)


def from_above(points_m: np.ndarray, colors: np.ndarray, half_m: float, size_px: int) -> np.ndarray:
    """Return a square map of points around the ego origin, forward up, left to the left; higher points hide lower ones.

    `points_m` is (P, 3) in the ego frame, `colors` (P, 3) uint8 RGB; `half_m` is from the map's middle to its edges.
    """
    canvas = blank(size_px, size_px, EMPTY)
    order = points_m[:, 2].argsort(kind="stable")
    places = ((half_m - points_m[order, :2]) * size_px / (2 * half_m)).astype(int)
    inside = ((places >= 1) & (places < size_px - 1)).all(1)
    places, paint = places[inside], colors[order][inside]
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            canvas[places[:, 0] + down, places[:, 1] + right] = paint
    draw_scale(canvas, size_px / (2 * half_m))
    return canvas
