"""Colours of ranges and of range errors, and colour bars with ticks in metres."""

from collections.abc import Sequence

import cv2
import numpy as np

from omniocc.draw.canvas import Rgb, blank, draw_text, text_width

NEAR_M, FAR_M = 1.0, 64.0
SKY: Rgb = (225, 233, 242)
NOT_PREDICTED: Rgb = (104, 108, 116)
FALSE_RANGE: Rgb = (150, 60, 170)  # a range is predicted where the truth is sky

RANGE_LEGEND = [("sky", SKY), ("not predicted", NOT_PREDICTED)]
ERROR_LEGEND = [("sky", SKY), ("predicted where there is sky", FALSE_RANGE), ("not predicted", NOT_PREDICTED)]
UNKNOWN_RANGE: tuple[str, Rgb] = ("not predicted: sky, not seen, or uncertain", NOT_PREDICTED)
"""Entry of the legend of predicted ranges."""

TURBO = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]

RANGE_TICKS_M = (1, 2, 4, 8, 16, 32, 64)
ERROR_TICKS_M = (-8, -4, -2, -1, -0.5, 0, 0.5, 1, 2, 4, 8)
LINEAR_ERROR_M, MAX_ERROR_M = 0.5, 8.0
"""The scale of errors is about linear below the first and logarithmic above it; the second has the full colour."""


def range_colors(range_m: np.ndarray) -> np.ndarray:
    """Return colours (..., 3) on a logarithmic scale from 1 m (red) to 64 m (blue); inf: sky, nan: not predicted."""
    finite = np.isfinite(range_m)
    level = np.log(np.where(finite, range_m, FAR_M).clip(NEAR_M, FAR_M) / NEAR_M) / np.log(FAR_M / NEAR_M)
    # near is at index 245 and far at 15, which leaves out the darkest colours at both ends
    colors = TURBO[(245 - 230 * level).round().astype(np.uint8)]
    colors[np.isposinf(range_m)] = SKY
    colors[np.isnan(range_m)] = NOT_PREDICTED
    return colors


def error_colors(predicted_m: np.ndarray, true_m: np.ndarray) -> np.ndarray:
    """Return colours (..., 3) of predicted minus true range: blue is too near, red is too far.

    Where the truth is sky (inf), pixels are `FALSE_RANGE` or, without a prediction, `SKY`. Pixels without a prediction
    or without truth (nan) are `NOT_PREDICTED`.
    """
    predicted = np.isfinite(predicted_m)
    both = predicted & np.isfinite(true_m)
    error_m = np.where(both, predicted_m, 0.0) - np.where(both, true_m, 0.0)
    colors = _diverging_colors(_scale_place(error_m))
    colors[~both] = NOT_PREDICTED
    colors[predicted & np.isposinf(true_m)] = FALSE_RANGE
    colors[~predicted & np.isposinf(true_m)] = SKY
    return colors


def range_bar(width: int) -> np.ndarray:
    """Return the image of a colour bar of `range_colors` with ticks in m, `width` px wide."""
    colors, ticks = range_scale(width)
    return _draw_bar(colors, [place for _, place in ticks], [f"{tick:g} m" for tick, _ in ticks])


def range_scale(count: int) -> tuple[np.ndarray, list[tuple[int, float]]]:
    """Return colours (count, 3) from near to far, and the ticks: each range in m with its place on the bar, 0 to 1."""
    places = [float(np.log(tick / NEAR_M) / np.log(FAR_M / NEAR_M)) for tick in RANGE_TICKS_M]
    return range_colors(np.geomspace(NEAR_M, FAR_M, count)), list(zip(RANGE_TICKS_M, places, strict=True))


def error_bar(width: int) -> np.ndarray:
    """Return the image of a colour bar of `error_colors` with ticks in m, `width` px wide."""
    places = ((_scale_place(np.array(ERROR_TICKS_M)) + 1) / 2).tolist()
    texts = [f"{tick:+g} m" if tick else "0" for tick in ERROR_TICKS_M]
    return _draw_bar(_diverging_colors(np.linspace(-1, 1, width)), places, texts)


def _scale_place(error_m: np.ndarray) -> np.ndarray:
    """Return the place of an error on the colour scale: -1 is too near, 1 too far."""
    magnitude = np.log1p(np.abs(error_m) / LINEAR_ERROR_M) / np.log1p(MAX_ERROR_M / LINEAR_ERROR_M)
    return np.sign(error_m) * magnitude.clip(0, 1)


def _diverging_colors(level: np.ndarray) -> np.ndarray:
    """Return colours of places on the scale: blue at -1, white at 0, red at 1."""
    white = np.array([250.0, 250.0, 250.0])
    end = np.where(level[..., None] < 0, np.array([20.0, 70.0, 190.0]), np.array([195.0, 25.0, 30.0]))
    weight = np.abs(level)[..., None] ** 0.8
    return (white + weight * (end - white)).round().astype(np.uint8)


def _draw_bar(colors: np.ndarray, places: Sequence[float], texts: Sequence[str]) -> np.ndarray:
    """Draw a horizontal colour bar with tick marks and texts at `places`, 0 to 1."""
    width, bar_px, text_px = len(colors), 12, 10
    canvas = blank(width, bar_px + 8 + text_px + 4)
    canvas[:bar_px] = colors
    for place, text in zip(places, texts, strict=True):
        column = min(round(place * width), width - 1)
        canvas[bar_px : bar_px + 5, max(column - 1, 0) : column + 1] = 90
        left = min(max(column - text_width(text, text_px) // 2, 0), width - text_width(text, text_px) - 1)
        draw_text(canvas, text, left, bar_px + 8 + text_px, text_px)
    return canvas
