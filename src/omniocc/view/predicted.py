"""One sheet per frame of predicted ranges without ground truth: the images warped by the ranges show their quality."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.view.canvas import blank, legend
from omniocc.view.depth import painted_rows
from omniocc.view.ranges import NOT_PREDICTED, range_bar, range_colors
from omniocc.view.sheet import caption_line, column_width, inner_width, panorama_row, row, stack


def predicted_sheet(
    images: Sequence[np.ndarray],
    rig: Rig,
    panorama: Equirectangular,
    range_m: Float[Tensor, "h w"],
    colors: UInt8[Tensor, "h w 3"],
    caption: str = "",
    half_m: float = 12.0,
    width_px: int = 1280,
) -> np.ndarray:
    """Return the sheet: ranges on the images, the images as one panorama at these ranges, ranges, points from above.

    Args:
        images: (H, W, 3) uint8 RGB of every camera.
        rig: the cameras.
        panorama: directions of the pixels of the ranges.
        range_m: ranges around the ego origin, nan where no range is predicted.
        colors: RGB of the points.
        caption: a line at the top.
        half_m: from the middle to the edges of the views from above.
        width_px: width of the sheet.
    """
    inner = inner_width(width_px)
    half = column_width(inner, 2)
    known = range_m.isfinite()
    points = (range_m.unsqueeze(-1) * panorama.rays())[known].numpy()
    shown = [colors[known].numpy(), range_colors(np.linalg.norm(points, axis=1))]
    above = [from_above(points, part, half_m, half) for part in shown]
    seen = np.where(known.numpy()[..., None], colors.numpy(), np.array(NOT_PREDICTED, np.uint8))
    rows = [
        *caption_line(caption, inner),
        *painted_rows(images, rig, panorama, range_m, inner),
        panorama_row(seen, "images at these ranges", inner),
        panorama_row(range_colors(range_m.numpy()), "range", inner),
        range_bar(inner),
        legend([("not predicted", NOT_PREDICTED)], inner),
        row(above, (f"points from above, {2 * half_m:g} m across", "their range"), inner),
    ]
    return stack(rows, width_px)


def from_above(points_m: np.ndarray, colors: np.ndarray, half_m: float, size_px: int) -> np.ndarray:
    """Return a square map of points around the ego origin, forward up, left to the left; higher points hide lower ones.

    Args:
        points_m: (P, 3), ego frame.
        colors: (P, 3) uint8 RGB.
        half_m: from the middle of the map to its edges.
        size_px: width and height.
    """
    canvas = blank(size_px, size_px, (238, 240, 243))
    order = points_m[:, 2].argsort(kind="stable")
    places = ((half_m - points_m[order, :2]) * size_px / (2 * half_m)).astype(int)
    inside = ((places >= 1) & (places < size_px - 1)).all(1)
    places, paint = places[inside], colors[order][inside]
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            canvas[places[:, 0] + down, places[:, 1] + right] = paint
    return canvas
