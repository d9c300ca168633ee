"""Trilinear interpolation along the axes of a grid."""

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


def trilinear(
    position: tuple[Float[Tensor, " N"], Float[Tensor, " N"], Float[Tensor, " N"]],
    shape: tuple[int, int, int],
    periodic: tuple[bool, bool, bool],
    dtype: torch.dtype,
) -> Corners:
    """Return the eight cells around each point, with their weights; border cells are repeated beyond the border.

    `position` is along each axis in units of cells (`Grid.coordinates`; float64 keeps the identity pose exact).
    """
    inside = torch.ones_like(position[0], dtype=torch.bool)
    cells, weights, stride = [], [], shape[0] * shape[1] * shape[2]
    for along, count, wraps in zip(position, shape, periodic, strict=True):
        if not wraps:
            inside &= (along >= 0) & (along < count)
        stride //= count
        offset = (along - 0.5).clamp(-1, count)
        lower = (offset + SNAP_CELLS).floor()
        fraction = offset - lower
        fraction = (fraction * (fraction > SNAP_CELLS)).to(torch.promote_types(dtype, torch.float32))
        steps, below = axis_steps(count, wraps, stride, along.device), lower.int() + 1
        cells.append((steps.index_select(0, below), steps.index_select(0, below + 1)))
        weights.append((1 - fraction, fraction))
    weights[0] = (weights[0][0] * inside, weights[0][1] * inside)
    # corner by corner on whole columns: much faster than broadcasting pairs
    first, second, third = (list(zip(*sides, strict=True)) for sides in zip(cells, weights, strict=True))
    columns = [(x + y, u * v) for x, u in first for y, v in second]
    corners = [(xy + z, uv * w) for xy, uv in columns for z, w in third]
    row, weight = (torch.stack(parts, dim=-1) for parts in zip(*corners, strict=True))
    return Corners(row, weight.to(dtype), inside)


@lru_cache(maxsize=64)
def axis_steps(cells: int, wraps: bool, stride: int, device: torch.device) -> Int32[Tensor, " steps"]:
    """Return the row-major offsets of indices -1 .. cells+1 of an axis, which wrap around or stop at its ends."""
    index = torch.arange(-1, cells + 2, dtype=torch.int32, device=device)
    return (index.remainder(cells) if wraps else index.clamp(0, cells - 1)) * stride


def interpolate(rows: Float[Tensor, "M C"], corners: Corners) -> Float[Tensor, "N C"]:
    """Return the weighted sum of the corners' rows for each point, 0 outside; differentiable in the rows.

    Rows are not copied: eight are read and one is written per point.
    """
    return F.embedding_bag(corners.cells, rows, per_sample_weights=corners.weights, mode="sum")
