"""Bird's-eye views: forward is up, left is left."""

import cv2
import numpy as np
import torch

from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.draw.canvas import Labels, Rgb, draw_scale, legend
from omniocc.geometry import Grid

OUTSIDE, EMPTY = (255, 255, 255), (238, 240, 243)
RIGHT, SHIFTED, WRONG = (196, 222, 200), (240, 225, 150), (240, 170, 50)
MISSED, HALLUCINATED = (50, 105, 195), (205, 50, 60)
ERRORS: tuple[tuple[str, Rgb], ...] = (
    ("right", RIGHT),
    ("at another height", SHIFTED),
    ("wrong class", WRONG),
    ("missed", MISSED),
    ("hallucinated", HALLUCINATED),
)


def bev(labels: Labels, geometry: Grid, classes: ClassTable, size_px: int) -> np.ndarray:
    """Return a square image of the whole grid, each column in the colour of its topmost occupied cell."""
    columns = topmost(labels)
    colors = classes.palette[columns]
    colors[columns == FREE] = EMPTY
    return draw_columns(colors, geometry, size_px)


def error_bev(truth: Labels, prediction: Labels, geometry: Grid, size_px: int) -> np.ndarray:
    """Return a square image with the most frequent kind of difference among the occupied cells of each column.

    Kinds and colours are `ERRORS`; of equally frequent kinds the first is drawn. Missed cells of a column with as many
    hallucinated ones and the right topmost class are 'at another height'. Cells of unknown truth do not count.
    """
    true, predicted = truth.numpy(), prediction.numpy()
    known = true != UNKNOWN

    def count(kind: np.ndarray) -> np.ndarray:
        return (kind & known).sum(2)

    right = count((true == predicted) & (true != FREE))
    wrong = count((true != predicted) & (true != FREE) & (predicted != FREE))
    missed, hallucinated = count((true != FREE) & (predicted == FREE)), count((true == FREE) & (predicted != FREE))
    shifted = np.where((missed == hallucinated) & (topmost(truth) == topmost(prediction)), missed, 0)
    counts = np.stack([right, shifted, wrong, missed, hallucinated])
    most = counts.argmax(0)
    colors = np.array([rgb for _, rgb in ERRORS], dtype=np.uint8)[most]
    colors[counts.sum(0) == 0] = EMPTY
    return draw_columns(colors, geometry, size_px)


def error_legend(width: int) -> np.ndarray:
    """Return a legend of `ERRORS`."""
    (first, rgb), *others = ERRORS
    return legend([(f"Difference: {first}", rgb), *others], width)


def topmost(labels: Labels) -> np.ndarray:
    """Return the class (X, Y) of the highest occupied cell of each column; free where there is none."""
    cells = labels.numpy()[:, :, ::-1]
    occupied = (cells != FREE) & (cells != UNKNOWN)
    first = occupied.argmax(2)
    return np.where(occupied.any(2), np.take_along_axis(cells, first[..., None], 2)[..., 0], FREE).astype(np.uint8)


def draw_columns(colors: np.ndarray, geometry: Grid, size_px: int) -> np.ndarray:
    """Return a square image of column colours (X, Y, 3); every pixel shows the column that its centre is in.

    The car and, if there is room, a bar of some metres are drawn over it.
    """
    edges = torch.meshgrid(*(geometry.edges(axis) for axis in range(3)), indexing="ij")
    half_m = float(geometry.from_axes(*edges)[..., :2].abs().max())
    axis = half_m - (torch.arange(size_px, dtype=torch.float64) + 0.5) * (2 * half_m / size_px)
    x, y = torch.meshgrid(axis, axis, indexing="ij")
    middle = sum(geometry.bounds[2]) / 2
    index, inside = geometry.index(torch.stack([x, y, torch.full_like(x, middle)], dim=-1))
    image = colors[index[..., 0].numpy(), index[..., 1].numpy()]
    image[~inside.numpy()] = OUTSIDE
    _draw_ego(image, size_px / (2 * half_m))
    draw_scale(image, size_px / (2 * half_m))
    return image


def _draw_ego(image: np.ndarray, px_per_m: float) -> None:
    """Draw an arrowhead at the origin that points forward, in place."""
    outline = np.array([[2.4, 0.0], [-2.0, 1.3], [-1.2, 0.0], [-2.0, -1.3]])  # x, y in metres
    pixels = np.stack([-outline[:, 1], -outline[:, 0]], 1) * px_per_m + image.shape[0] / 2 - 0.5
    points = np.round(pixels * 16).astype(np.int32)
    cv2.fillPoly(image, [points], (255, 255, 255), cv2.LINE_AA, shift=4)
    cv2.polylines(image, [points], True, (30, 30, 30), 1, cv2.LINE_AA, shift=4)
