"""One sheet per frame of a sketch: candidate voxels over the true ones, from above."""

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from omniocc.camera import Equirectangular
from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.draw.bev import EMPTY, MISSED, bev, draw_columns
from omniocc.draw.canvas import Images, Labels, Ranges, Rgb, class_legend, legend
from omniocc.draw.ranges import range_bar, range_colors
from omniocc.draw.sheet import camera_rows, column_width, inner_width, row, stack
from omniocc.geometry import Grid

HIT, SUPERFLUOUS = (90, 165, 100), (240, 190, 90)
KINDS: tuple[tuple[str, Rgb], ...] = (
    ("occupied and a candidate", HIT),
    ("free but a candidate", SUPERFLUOUS),
    ("occupied but missed", MISSED),
)


def sketch_sheet(
    images: Images,
    truth: Labels,
    candidates: Bool[Tensor, "X Y Z"],
    dilated: Bool[Tensor, "X Y Z"],
    geometry: Grid,
    classes: ClassTable,
    panorama: Equirectangular,
    range_m: Ranges,
    caption: str = "",
    width_px: int = 1280,
) -> np.ndarray:
    """Return the sheet: cameras; true voxels beside the sketch's input points; candidates before and after dilation.

    `candidates` are before dilation; `panorama` has the directions of the ranges, `caption` is the line at the top.
    """
    inner = inner_width(width_px)
    half = column_width(inner, 2)
    inputs = [bev(truth, geometry, classes, half), points_bev(range_m, panorama, geometry, half)]
    results = [candidate_bev(truth, mask, geometry, half) for mask in (candidates, dilated)]
    names = [f"candidates before dilation: {scores(truth, candidates)}", f"after: {scores(truth, dilated)}"]
    kinds = [("Most cells of the column: " + KINDS[0][0], HIT), *KINDS[1:], ("free, not a candidate", EMPTY)]
    rows = [
        *camera_rows(images, inner, columns=6 if len(images) % 6 == 0 else 4),
        row(inputs, ("true voxels, topmost", "points of the predicted ranges"), inner),
        class_legend(classes, inner),
        range_bar(inner),
        row(results, names, inner),
        legend(kinds, inner),
    ]
    return stack(rows, width_px, caption)


def candidate_bev(truth: Labels, candidates: Bool[Tensor, "X Y Z"], geometry: Grid, size_px: int) -> np.ndarray:
    """Return an image of the most frequent of `KINDS` in each column, at a tie the last; unknown cells are ignored."""
    occupied, free = (truth != FREE) & (truth != UNKNOWN), truth == FREE
    kinds = (occupied & candidates, free & candidates, occupied & ~candidates)
    counts = torch.stack([kind.sum(2) for kind in kinds]).numpy()
    most = len(kinds) - 1 - counts[::-1].argmax(0)
    colors = np.array([rgb for _, rgb in KINDS], dtype=np.uint8)[most]
    colors[counts.sum(0) == 0] = EMPTY
    return draw_columns(colors, geometry, size_px)


def points_bev(range_m: Ranges, panorama: Equirectangular, geometry: Grid, size_px: int) -> np.ndarray:
    """Return an image of the range of the highest point in each column, in the colours of `range_colors`."""
    points = (range_m.unsqueeze(-1) * panorama.rays())[range_m.isfinite()]
    points = points[points[:, 2].argsort()]
    index, inside = geometry.index(points)
    columns = np.full((*geometry.shape[:2], 3), EMPTY, dtype=np.uint8)
    first, second = index[inside][:, :2].unbind(1)
    columns[first.numpy(), second.numpy()] = range_colors(points[inside].norm(dim=-1).numpy())
    return draw_columns(columns, geometry, size_px)


def scores(truth: Labels, candidates: Bool[Tensor, "X Y Z"]) -> str:
    """Return recall, precision and fraction of candidates in a few words."""
    occupied, known = (truth != FREE) & (truth != UNKNOWN), truth != UNKNOWN
    found = (occupied & candidates).sum()
    recall = found / occupied.sum().clamp(min=1)
    precision = found / (known & candidates).sum().clamp(min=1)
    return f"recall {recall:.2f}, precision {precision:.2f}, fraction {candidates.float().mean():.2f}"
