"""Sheets: rows of tagged pictures under a caption."""

from collections.abc import Sequence

import cv2
import numpy as np

from omniocc.view.canvas import blank, fitted, paste, tag, write

NAMES = ("front", "front right", "rear right", "rear", "rear left", "front left")
AS_SEEN = (5, 0, 1, 4, 3, 2)
MARGIN, GAP = 14, 6


def inner_width(width_px: int) -> int:
    """What the margins leave of a sheet's width."""
    return width_px - 2 * MARGIN


def column_width(width: int, columns: int) -> int:
    """Width of each of some pictures side by side."""
    return (width - (columns - 1) * GAP) // columns


def camera_rows(
    images: Sequence[np.ndarray], width: int, columns: int = 3, names: Sequence[str] | None = None
) -> list[np.ndarray]:
    """Pictures of the cameras, some in a row.

    Args:
        images: RGB pictures; six without names are the hexagon's (0 front, then clockwise), placed as they look.
        width: of a row.
        columns: pictures in a row.
        names: of the cameras; None if they have none.
    """
    six = names is None and len(images) == len(NAMES)
    order = AS_SEEN if six else range(len(images))
    tags = NAMES if six else names or [f"camera {k}" for k in range(len(images))]
    pictures = [fitted(images[k], column_width(width, columns)) for k in order]
    chosen = [tags[k] for k in order]
    return [row(pictures[k : k + columns], chosen[k : k + columns], width) for k in range(0, len(pictures), columns)]


def row(pictures: Sequence[np.ndarray], names: Sequence[str], width: int) -> np.ndarray:
    """Pictures side by side, each with its name on it."""
    return beside([tagged(picture, name) for picture, name in zip(pictures, names, strict=True)], width)


def tagged(picture: np.ndarray, name: str) -> np.ndarray:
    """Return a copy of a picture with its name on it."""
    picture = picture.copy()
    tag(picture, name, 8, 8)
    return picture


def beside(pictures: Sequence[np.ndarray], width: int) -> np.ndarray:
    """Return pictures side by side on a canvas of a width."""
    canvas = blank(width, max(len(picture) for picture in pictures))
    left = 0
    for picture in pictures:
        paste(canvas, picture, left, 0)
        left += picture.shape[1] + GAP
    return canvas


def below(rows: Sequence[np.ndarray], width: int) -> np.ndarray:
    """Return rows below one another on a canvas of a width, without margins."""
    canvas = blank(width, sum(map(len, rows)) + GAP * (len(rows) - 1))
    top = 0
    for picture in rows:
        paste(canvas, picture, 0, top)
        top += len(picture) + GAP
    return canvas


def panorama_row(colors: np.ndarray, name: str, width: int) -> np.ndarray:
    """A picture of few pixels scaled to a width, every pixel a rectangle, with its name on it."""
    height = round(colors.shape[0] * width / colors.shape[1])
    picture = cv2.resize(colors, (width, height), interpolation=cv2.INTER_NEAREST)
    tag(picture, name, 8, 8)
    return picture


def caption_line(text: str, width: int) -> list[np.ndarray]:
    """The first row of a sheet; no row without a text."""
    if not text:
        return []
    line = blank(width, 24)
    write(line, text, 0, 17, 12)
    return [line]


def stack(rows: Sequence[np.ndarray], width_px: int) -> np.ndarray:
    """Rows below one another, with margins around them."""
    inner = below(rows, inner_width(width_px))
    canvas = blank(width_px, len(inner) + 2 * MARGIN)
    paste(canvas, inner, MARGIN, MARGIN)
    return canvas
