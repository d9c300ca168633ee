"""Colours of ranges and of their errors, and colour bars that explain them."""

from collections.abc import Sequence

import cv2
import numpy as np

from omniocc.draw.canvas import Rgb, blank, draw_text, text_width

NEAR_M, FAR_M = 1.0, 64.0
SKY: Rgb = (225, 233, 242)
NOT_PREDICTED: Rgb = (104, 108, 116)
FALSE_RANGE: Rgb = (150, 60, 170)

TURBO = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]

RANGE_TICKS_M = (1, 2, 4, 8, 16, 32, 64)
ERROR_TICKS_M = (-8, -4, -2, -1, -0.5, 0, 0.5, 1, 2, 4, 8)
LINEAR_M, GREATEST_M = 0.5, 8.0
"""Errors are drawn on a scale that is linear below the first and logarithmic up to the second."""


def range_colors(range_m: np.ndarray) -> np.ndarray:
    """Return colours (..., 3) of the logarithm from 1 m (red) to 64 m (blue); inf is sky, nan not predicted."""
    finite = np.isfinite(range_m)
    level = np.log(np.where(finite, range_m, FAR_M).clip(NEAR_M, FAR_M) / NEAR_M) / np.log(FAR_M / NEAR_M)
    colors = TURBO[(245 - 230 * level).round().astype(np.uint8)]
    colors[np.isposinf(range_m)] = SKY
    colors[np.isnan(range_m)] = NOT_PREDICTED
    return colors


def error_colors(predicted_m: np.ndarray, true_m: np.ndarray) -> np.ndarray:
    """Return colours (..., 3): blue for too near, red for too far, and `SKY`, `FALSE_RANGE`, `NOT_PREDICTED`."""
    predicted = np.isfinite(predicted_m)
    both = predicted & np.isfinite(true_m)
    error_m = np.where(both, predicted_m, 0.0) - np.where(both, true_m, 0.0)
    colors = _diverging_colors(_level(error_m))
    colors[~both] = NOT_PREDICTED
    colors[predicted & np.isposinf(true_m)] = FALSE_RANGE
    colors[~predicted & np.isposinf(true_m)] = SKY
    return colors


def range_bar(width: int) -> np.ndarray:
    """Return a bar with the colours of `range_colors` and their ranges."""
    colors, ticks = range_scale(width)
    return _bar(colors, [place for _, place in ticks], [f"{tick:g} m" for tick, _ in ticks])


def range_scale(count: int) -> tuple[np.ndarray, list[tuple[int, float]]]:
    """Return `count` colours (count, 3) from near to far, and the ticks: range in m and its place from 0 to 1."""
    places = [float(np.log(tick / NEAR_M) / np.log(FAR_M / NEAR_M)) for tick in RANGE_TICKS_M]
    return range_colors(np.geomspace(NEAR_M, FAR_M, count)), list(zip(RANGE_TICKS_M, places, strict=True))


def error_bar(width: int) -> np.ndarray:
    """Return a bar with the colours of `error_colors` and their errors."""
    places = ((_level(np.array(ERROR_TICKS_M)) + 1) / 2).tolist()
    texts = [f"{tick:+g} m" if tick else "0" for tick in ERROR_TICKS_M]
    return _bar(_diverging_colors(np.linspace(-1, 1, width)), places, texts)


def _level(error_m: np.ndarray) -> np.ndarray:
    """Return the place of an error on the colour scale, -1 to 1."""
    size = np.log1p(np.abs(error_m) / LINEAR_M) / np.log1p(GREATEST_M / LINEAR_M)
    return np.sign(error_m) * size.clip(0, 1)


def _diverging_colors(level: np.ndarray) -> np.ndarray:
    """Return colours that are white at 0, blue towards -1 and red towards 1."""
    white = np.array([250.0, 250.0, 250.0])
    end = np.where(level[..., None] < 0, np.array([20.0, 70.0, 190.0]), np.array([195.0, 25.0, 30.0]))
    weight = np.abs(level)[..., None] ** 0.8
    return (white + weight * (end - white)).round().astype(np.uint8)


def _bar(colors: np.ndarray, places: Sequence[float], texts: Sequence[str]) -> np.ndarray:
    width, thick, height_px = len(colors), 12, 10
    canvas = blank(width, thick + 8 + height_px + 4)
    canvas[:thick] = colors
    for place, text in zip(places, texts, strict=True):
        at = min(round(place * width), width - 1)
        canvas[thick : thick + 5, max(at - 1, 0) : at + 1] = 90
        left = min(max(at - text_width(text, height_px) // 2, 0), width - text_width(text, height_px) - 1)
        draw_text(canvas, text, left, thick + 8 + height_px, height_px)
    return canvas
