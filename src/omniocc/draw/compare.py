"""One sheet per frame: camera images, true beside predicted voxels, and where they differ."""

from typing import NamedTuple

import numpy as np

from omniocc.classes import ClassTable
from omniocc.draw.bev import bev, error_bev, error_legend
from omniocc.draw.canvas import Labels, class_legend
from omniocc.draw.sheet import below, beside, camera_rows, column_width, inner_width, stack, tagged
from omniocc.draw.voxels import CAR_SIZE, render_voxels
from omniocc.geometry import Grid


class SheetParts(NamedTuple):
    """Parts of a sheet, RGB: images of the cameras, voxels in perspective, and voxels from above."""

    cameras: np.ndarray
    truth: np.ndarray
    prediction: np.ndarray
    truth_map: np.ndarray
    prediction_map: np.ndarray
    differences: np.ndarray


def comparison_parts(
    images: np.ndarray,
    truth: Labels,
    prediction: Labels,
    geometry: Grid,
    classes: ClassTable,
    width_px: int = 1280,
) -> SheetParts:
    """Return the parts of a sheet of a width, px.

    `images` are (N, H, W, 3) uint8 RGB; six are those of the hexagon (0 front, then clockwise).
    """
    inner = inner_width(width_px)
    views, maps = views_and_maps(truth, prediction, geometry, classes, inner)
    names = (
        f"truth from behind; {CAR_SIZE}",
        "prediction from behind",
        "truth from above",
        "prediction from above",
        "differences",
    )
    drawn = (tagged(image, name) for image, name in zip((*views, *maps), names, strict=True))
    return SheetParts(below(camera_rows(list(images), inner), inner), *drawn)


def views_and_maps(
    truth: Labels, prediction: Labels, geometry: Grid, classes: ClassTable, width: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return both in perspective, and both and their differences from above: images for two rows of a width, px."""
    half, third = column_width(width, 2), column_width(width, 3)
    views = [render_voxels(labels, geometry, classes, half, half * 9 // 16) for labels in (truth, prediction)]
    maps = [bev(labels, geometry, classes, third) for labels in (truth, prediction)]
    return views, [*maps, error_bev(truth, prediction, geometry, third)]


def comparison_sheet(parts: SheetParts, classes: ClassTable, caption: str = "", width_px: int = 1280) -> np.ndarray:
    """Return the sheet made of these parts, drawn for its width; `caption` is the line at the top."""
    inner = inner_width(width_px)
    rows = [
        parts.cameras,
        beside([parts.truth, parts.prediction], inner),
        beside([parts.truth_map, parts.prediction_map, parts.differences], inner),
        class_legend(classes, inner),
        error_legend(inner),
    ]
    return stack(rows, width_px, caption)
