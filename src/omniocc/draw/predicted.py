"""One sheet per frame of predicted ranges without ground truth: the images warped by the ranges show their quality."""

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.draw.bev import EMPTY
from omniocc.draw.canvas import Images, Ranges, blank, legend
from omniocc.draw.depth import painted_rows
from omniocc.draw.ranges import NOT_PREDICTED, range_bar, range_colors
from omniocc.draw.sheet import column_width, inner_width, panorama_row, row, stack


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
        panorama_row(range_colors(range_m.numpy()), "range", inner),
        range_bar(inner),
        legend([("not predicted", NOT_PREDICTED)], inner),
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
    return canvas
