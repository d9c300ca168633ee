"""What sits on a lens: drops of rain, which refract and blur the view, and dirt, which hides it."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64

from omniocc.data.augment.degrade import Image, blurred

DROP = (0.02, 0.09)
"""Least and greatest radius of a drop, as a fraction of the image's height."""
REACH = 4.0
"""How many times as wide as the drop itself is what is seen through it, upside down."""
BLUR = 0.015
"""Standard deviation of the blur in a drop, as a fraction of the image's height."""
DIRT_RGB = (58, 50, 42)
GRAIN = 0.08
"""Size of a spot of dirt, as a fraction of the image's height."""


class Drops(NamedTuple):
    """Drops of rain on a lens.

    Attributes:
        column: pixel of the image that each pixel shows.
        row: the same.
        cover: how much of each pixel a drop covers, 0..1.
        shade: factor on the light of each pixel: drops are darker at their upper rim.
    """

    column: Float32[np.ndarray, "H W"]
    row: Float32[np.ndarray, "H W"]
    cover: Float32[np.ndarray, "H W"]
    shade: Float32[np.ndarray, "H W"]


def draw_drops(seen: Bool[np.ndarray, "H W"], percent: float, rng: np.random.Generator) -> Drops:
    """Return drops of random places and sizes that cover at least `percent` of the pixels that the lens sees."""
    height, width = size = seen.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    drops = Drops(columns.copy(), rows.copy(), np.zeros(size, np.float32), np.ones(size, np.float32))
    while 100 * float((drops.cover[seen] > 0.5).mean()) < percent:
        radius = height * float(rng.uniform(*DROP))
        middle = (float(rng.uniform(0, width)), float(rng.uniform(0, height)))
        window = _around(middle, 1.2 * radius, size)
        across, down = columns[window] - middle[0], 0.85 * (rows[window] - middle[1])  # a little taller than wide
        away = np.hypot(across, down) / radius
        inside = np.clip((1.1 - away) / 0.2, 0, 1)
        newer = inside > drops.cover[window]
        drops.cover[window] = np.maximum(drops.cover[window], inside)
        for target, value in (
            (drops.column, middle[0] - REACH * across),
            (drops.row, middle[1] - REACH * down),
            (drops.shade, 1 - 0.35 * np.clip(away, 0, 1) ** 3 * (down < 0)),
        ):
            target[window] = np.where(newer, value, target[window])
    return drops._replace(cover=drops.cover * seen)


def through_drops(image: Image, drops: Drops) -> Image:
    """Return the image as it is seen through drops: inside of them turned upside down, smaller, and out of focus."""
    soft = blurred(image, BLUR * image.shape[0])
    seen = np.asarray(cv2.remap(soft, drops.column, drops.row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT))
    cover = drops.cover[..., None]
    mixed = image * (1 - cover) + seen * (cover * drops.shade[..., None])
    return np.rint(mixed).astype(np.uint8)


def draw_dirt(seen: Bool[np.ndarray, "H W"], percent: float, rng: np.random.Generator) -> Float32[np.ndarray, "H W"]:
    """Return how much of each pixel dirt hides, 0..1: more than half of it in `percent` of those that the lens sees."""
    size = seen.shape
    field = np.zeros(size, np.float32)
    for octave in range(3):
        sigma_px = GRAIN * size[0] / 2**octave
        noise = cv2.GaussianBlur(rng.standard_normal(size, dtype=np.float32), (0, 0), sigma_px)
        field += np.asarray(noise) * (sigma_px / 2**octave)  # of equal spread, then half as strong as the one before
    edge = float(np.quantile(field[seen], 1 - percent / 100))
    return (np.clip(0.5 + (field - edge) / (0.2 * float(field.std())), 0, 1) * seen).astype(np.float32)


def behind_dirt(image: Image, dirt: Float32[np.ndarray, "H W"]) -> Image:
    """Return the image behind dirt of one colour."""
    cover = dirt[..., None]
    return np.rint(image * (1 - cover) + np.array(DIRT_RGB, np.float32) * cover).astype(np.uint8)


def _around(middle: tuple[float, float], reach_px: float, size: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of an image within a distance from a point (column, row)."""
    (column, row), (height, width) = middle, size
    first: Int64[np.ndarray, "2"] = np.floor(np.array([row, column]) - reach_px).astype(int)
    last = np.ceil(np.array([row, column]) + reach_px).astype(int) + 1
    return slice(max(first[0], 0), min(last[0], height)), slice(max(first[1], 0), min(last[1], width))
