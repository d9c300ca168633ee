"""One sheet per frame: what the cameras saw, true beside predicted voxels, and where they differ."""

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from omniocc.classes import CLASSES, FREE
from omniocc.geometry import Grid
from omniocc.view.bev import ERRORS, bev, error_bev
from omniocc.view.canvas import blank, fitted, legend, paste, tag, write
from omniocc.view.voxels import render_voxels

NAMES = ("front", "front right", "rear right", "rear", "rear left", "front left")
AS_SEEN = (5, 0, 1, 4, 3, 2)
MARGIN, GAP = 14, 6


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
    inner = width_px - 2 * MARGIN
    rows = [_caption(caption, inner)] if caption else []
    rows += _camera_rows(images, inner)
    half = (inner - GAP) // 2
    views = [render_voxels(labels, geometry, half, half * 9 // 16) for labels in (truth, prediction)]
    rows.append(_row(views, ("truth", "prediction"), inner))
    third = (inner - 2 * GAP) // 3
    maps = [
        bev(truth, geometry, third),
        bev(prediction, geometry, third),
        error_bev(truth, prediction, geometry, third),
    ]
    rows.append(_row(maps, ("truth from above", "prediction from above", "differences"), inner))
    rows.append(legend([(row.name, row.rgb) for row in CLASSES if row.id != FREE], inner))
    rows.append(
        legend([(f"Difference: {name}" if k == 0 else name, rgb) for k, (name, rgb) in enumerate(ERRORS)], inner)
    )
    return _stack(rows, width_px)


def _camera_rows(images: np.ndarray, width: int) -> list[np.ndarray]:
    six = len(images) == len(NAMES)
    order = AS_SEEN if six else range(len(images))
    third = (width - 2 * GAP) // 3
    pictures = [fitted(images[k], third) for k in order]
    names = [NAMES[k] if six else f"camera {k}" for k in order]
    return [_row(pictures[k : k + 3], tuple(names[k : k + 3]), width) for k in range(0, len(pictures), 3)]


def _row(pictures: list[np.ndarray], names: tuple[str, ...], width: int) -> np.ndarray:
    row = blank(width, max(len(picture) for picture in pictures))
    left = 0
    for picture, name in zip(pictures, names, strict=True):
        picture = picture.copy()
        tag(picture, name, 8, 8)
        paste(row, picture, left, 0)
        left += picture.shape[1] + GAP
    return row


def _caption(text: str, width: int) -> np.ndarray:
    line = blank(width, 24)
    write(line, text, 0, 17, 12)
    return line


def _stack(rows: list[np.ndarray], width: int) -> np.ndarray:
    height = 2 * MARGIN + sum(len(row) for row in rows) + GAP * (len(rows) - 1)
    sheet = blank(width, height)
    top = MARGIN
    for row in rows:
        paste(sheet, row, MARGIN, top)
        top += len(row) + GAP
    return sheet
