"""Sheets: rows of named images below a caption."""

from collections.abc import Sequence

import cv2
import numpy as np

from omniocc.camera import Equirectangular
from omniocc.draw.canvas import Images, blank, draw_label, draw_text, fitted, paste, text_width

NAMES = ("front", "front right", "rear right", "rear", "rear left", "front left")
HEXAGON_ORDER = (5, 0, 1, 4, 3, 2)
"""Cameras of the hexagon in two rows, placed by their directions."""
MARGIN, GAP = 14, 6


def inner_width(width_px: int) -> int:
    """Return the width of a sheet between its margins."""
    return width_px - 2 * MARGIN


def column_width(width: int, columns: int) -> int:
    """Return the width of each of several images side by side."""
    return (width - (columns - 1) * GAP) // columns


def camera_rows(images: Images, width: int, columns: int = 3, names: Sequence[str] | None = None) -> list[np.ndarray]:
    """Return rows of named camera images, in all `width` px wide.

    Six images without names are those of the hexagon (0 front, then clockwise) and are placed by direction.
    """
    six = names is None and len(images) == len(NAMES)
    order = HEXAGON_ORDER if six else range(len(images))
    tags = NAMES if six else names or [f"camera {k}" for k in range(len(images))]
    images = [fitted(images[k], column_width(width, columns)) for k in order]
    shown = [tags[k] for k in order]
    return [row(images[k : k + columns], shown[k : k + columns], width) for k in range(0, len(images), columns)]


def row(images: Images, names: Sequence[str], width: int) -> np.ndarray:
    """Return images side by side, each with its name on it."""
    return beside([tagged(image, name) for image, name in zip(images, names, strict=True)], width)


def tagged(image: np.ndarray, name: str) -> np.ndarray:
    """Return a copy of an image with its name on it."""
    image = image.copy()
    draw_label(image, name, 8, 8)
    return image


def beside(images: Images, width: int) -> np.ndarray:
    """Return images side by side on a canvas of a width."""
    canvas = blank(width, max(len(image) for image in images))
    left = 0
    for image in images:
        paste(canvas, image, left, 0)
        left += image.shape[1] + GAP
    return canvas


def below(rows: Images, width: int) -> np.ndarray:
    """Return rows below one another on a canvas of a width, without margins."""
    canvas = blank(width, sum(map(len, rows)) + GAP * (len(rows) - 1))
    top = 0
    for image in rows:
        paste(canvas, image, 0, top)
        top += len(image) + GAP
    return canvas


def panorama_row(colors: np.ndarray, name: str, width: int) -> np.ndarray:
    """Return a small image scaled to a width, every pixel a rectangle, with its name on it."""
    return tagged(fitted(colors, width, cv2.INTER_NEAREST), name)


def azimuths(width: int) -> np.ndarray:
    """Return the names of directions below a panorama."""
    canvas = blank(width, 16)
    for text, place in (("back", 0), ("left", 0.25), ("front", 0.5), ("right", 0.75), ("back", 1)):
        left = int(place * width - text_width(text, 10) / 2)
        draw_text(canvas, text, min(max(left, 0), width - text_width(text, 10)), 13, 10)
    return canvas


def elevations(panorama: Equirectangular) -> str:
    """Return the upper and lower edge of a panorama in words."""
    return f"from {panorama.top_deg:+g} to {panorama.bottom_deg:+g} deg"


def stack(rows: Images, width_px: int, caption: str = "") -> np.ndarray:
    """Return rows below one another and below a caption, if it is not empty, with margins around them."""
    if caption:
        line = blank(inner_width(width_px), 24)
        draw_text(line, caption, 0, 17, 12)
        rows = [line, *rows]
    inner = below(rows, inner_width(width_px))
    canvas = blank(width_px, len(inner) + 2 * MARGIN)
    paste(canvas, inner, MARGIN, MARGIN)
    return canvas
