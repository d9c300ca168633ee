"""One sheet per frame: what the cameras saw, true beside predicted voxels, and where they differ."""

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from omniocc.classes import CLASSES, FREE
from omniocc.geometry import Grid
from omniocc.view.bev import ERRORS, bev, error_bev
from omniocc.view.canvas import legend
from omniocc.view.sheet import AS_SEEN as AS_SEEN
from omniocc.view.sheet import NAMES as NAMES
from omniocc.view.sheet import camera_rows, caption_line, column_width, inner_width, row, stack
from omniocc.view.voxels import render_voxels


def comparison(
    images: np.ndarray,
    truth: UInt8[Tensor, "X Y Z"],
    prediction: UInt8[Tensor, "X Y Z"],
    geometry: Grid,
    caption: str = "",
    width_px: int = 1280,
) -> np.ndarray:
    """Draws the sheet.

    Args:
        images: (N, H, W, 3) uint8 RGB; six are taken for the hexagon (0 front, then clockwise), others go in order.
        truth: class of every cell.
        prediction: class of every cell.
        geometry: the grid of both.
        caption: a line at the top.
        width_px: of the sheet.
    """
    inner = inner_width(width_px)
    half, third = column_width(inner, 2), column_width(inner, 3)
    views = [render_voxels(labels, geometry, half, half * 9 // 16) for labels in (truth, prediction)]
    maps = [
        bev(truth, geometry, third),
        bev(prediction, geometry, third),
        error_bev(truth, prediction, geometry, third),
    ]
    rows = [
        *caption_line(caption, inner),
        *camera_rows(list(images), inner),
        row(views, ("truth", "prediction"), inner),
        row(maps, ("truth from above", "prediction from above", "differences"), inner),
        class_legend(inner),
        legend([(f"Difference: {name}" if k == 0 else name, rgb) for k, (name, rgb) in enumerate(ERRORS)], inner),
    ]
    return stack(rows, width_px)


def class_legend(width: int) -> np.ndarray:
    """Names and colours of all classes but free."""
    return legend([(entry.name, entry.rgb) for entry in CLASSES if entry.id != FREE], width)
