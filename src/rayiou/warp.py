"""Trilinear interpolation along the axes of a grid."""

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int32, Int64
from torch import Tensor
from torch.nn import functional as F

SNAP_CELLS = 1e-6
"""Positions this close to a cell centre count as the centre, so that the identity pose changes no bit."""


class Corners(NamedTuple):
    """The eight cells whose centres surround each point.

    Attributes:
        cells: row-major indices.
        weights: sum to 1; 0 for points outside the grid.
        inside: whether the point is inside the grid.
    """

    cells: Int32[Tensor, "N 8"]
    weights: Float[Tensor, "N 8"]
    inside: Bool[Tensor, " N"]


def fold(index: Int64[Tensor, "..."], cells: int) -> Int64[Tensor, "..."]:
    """Return indices of a periodic axis, at most one turn outside the grid, moved into it; cheaper than a remainder."""
    return index + cells * ((index < 0).long() - (index >= cells).long())


class Axes(NamedTuple):
    """Constants of the three axes of a grid.

    Attributes:
        low: smallest position inside, in cells; -inf where an axis wraps around.
        high: least position beyond it; inf where it wraps around.
        cells: number of cells.
        steps: row-major offsets of the indices -1 .. cells+1 of each axis, wrapping around or stopping at its ends.
        zero: place of index 0 of each axis in `steps`.
    """

    low: Float[Tensor, "3 1"]
    high: Float[Tensor, "3 1"]
    cells: Float[Tensor, "3 1"]
    steps: Int32[Tensor, " steps"]
    zero: Int32[Tensor, "3 1"]


@lru_cache(maxsize=64)
def axes_of(
    shape: tuple[int, int, int], periodic: tuple[bool, bool, bool], dtype: torch.dtype, device: torch.device
) -> Axes:
    """Return the constants of a grid's axes."""
    steps, zero, infinity = [], [], float("inf")
    for axis, (cells, wraps) in enumerate(zip(shape, periodic, strict=True)):
        index = torch.arange(-1, cells + 2, dtype=torch.int32)
        zero.append(sum(map(len, steps)) + 1)
        steps.append((index.remainder(cells) if wraps else index.clamp(0, cells - 1)) * math.prod(shape[axis + 1 :]))
    low = [-infinity if wraps else 0.0 for wraps in periodic]
    high = [infinity if wraps else float(cells) for cells, wraps in zip(shape, periodic, strict=True)]
    columns = [torch.tensor(values, dtype=dtype, device=device)[:, None] for values in (low, high, shape)]
    starts = torch.tensor(zero, dtype=torch.int32, device=device)[:, None]
    return Axes(columns[0], columns[1], columns[2], torch.cat(steps).to(device), starts)


def trilinear(
    position: Float[Tensor, "3 N"], shape: tuple[int, int, int], periodic: tuple[bool, bool, bool], dtype: torch.dtype
) -> Corners:
    """Return the eight cells around each point, with their weights; border cells are repeated beyond the border.

    `position` is along each axis in units of cells (`Grid.coordinates`; float64 keeps the identity pose exact).
    """
    axes = axes_of(shape, periodic, position.dtype, position.device)
    inside = ((position >= axes.low) & (position < axes.high)).all(0)
    offset = (position - 0.5).clamp(-torch.ones_like(axes.cells), axes.cells)
    lower = (offset + SNAP_CELLS).floor()
    fraction = offset - lower
    fraction = (fraction * (fraction > SNAP_CELLS)).to(torch.promote_types(dtype, torch.float32))
    below = lower.int() + axes.zero
    first, second, third = axes.steps.index_select(0, torch.cat([below, below + 1]).flatten()).view(2, 3, -1).unbind(1)
    along, across, up = torch.stack([1 - fraction, fraction]).unbind(1)
    along = along * inside
    # corner by corner on whole columns: much faster than with the corners of a point side by side
    row = (first[:, None, None] + second[:, None]) + third
    weight = (along[:, None, None] * across[:, None]) * up
    return Corners(row.flatten(0, 2).T.contiguous(), weight.flatten(0, 2).T.contiguous().to(dtype), inside)


def interpolate(rows: Float[Tensor, "M C"], corners: Corners) -> Float[Tensor, "N C"]:
    """Return the weighted sum of the corners' rows for each point, 0 outside; differentiable in the rows.

    Rows are not copied: eight are read and one is written per point.
    """
    return F.embedding_bag(corners.cells, rows, per_sample_weights=corners.weights, mode="sum")
