"""Falling rain as streaks over an image."""

from functools import lru_cache

import numpy as np

_SIZE = 512
_SLANT = 0.12


def streaks(size: tuple[int, int], pixel: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return (P,) float32 fraction, 0..1, of each pixel's view that drops hide.

    `size` is the image's height and width, `pixel` (P,) the index into the flattened image.
    """
    scale = _SIZE / (1.2 * size[0])
    shift = rng.integers(0, _SIZE, 2)
    row = ((pixel // size[1]) * scale + shift[0]).astype(np.int32) & (_SIZE - 1)
    column = ((pixel % size[1]) * scale + shift[1]).astype(np.int32) & (_SIZE - 1)
    return _pattern()[row * _SIZE + column]


@lru_cache(maxsize=1)
def _pattern() -> np.ndarray:
    rng = np.random.default_rng(29)
    pattern = np.zeros((_SIZE, _SIZE), np.float32)
    for _ in range(700):
        length, width = int(rng.integers(14, 70)), int(rng.integers(1, 4))
        row, column, strength = int(rng.integers(_SIZE)), int(rng.integers(_SIZE)), rng.uniform(0.15, 0.6) / width
        rows = (row + np.arange(length)) % _SIZE
        fade = np.sin(np.pi * (np.arange(length) + 0.5) / length)
        for offset in range(width):
            columns = (column + offset + np.rint(_SLANT * np.arange(length)).astype(int)) % _SIZE
            pattern[rows, columns] += (strength * fade).astype(np.float32)
    return np.minimum(pattern, 0.7).ravel()
