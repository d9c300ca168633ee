"""Widening of a mask along the horizontal rays from the z axis, where the range of a surface is uncertain."""

import functools
import itertools
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from omniocc.geometry.lattice import Lattice


def dilate(
    grid: Lattice, mask: Bool[Tensor, "*B X Y Z"], windows: Sequence[int], edges_m: Sequence[float | int]
) -> Bool[Tensor, "*B X Y Z"]:
    """Return a mask widened towards and away from the z axis, by more the farther a cell is (paper, section IV-B).

    In a cylinder a cell marks the `window` next cells on either side of it along r. In a cuboid it marks the cells that
    hold the points up to `window` cell lengths before and behind its middle, on the horizontal ray from the axis: the
    same region of space for cells of the same length. Heights do not change, and no mark crosses the axis.

    Args:
        grid: cylinder or cuboid.
        mask: cells to widen, batch axes first.
        windows: half-width in cells for each range band, one more than there are edges.
        edges_m: distances of cell middles from the axis at which one band ends and the next begins.

    Raises:
        ValueError: if mask, windows and edges do not fit together.
    """
    if tuple(mask.shape[-3:]) != grid.shape:
        raise ValueError(f"mask must end with the grid's shape {grid.shape}, got {tuple(mask.shape)}")
    rising = all(low < high for low, high in itertools.pairwise(edges_m))
    if len(windows) != len(edges_m) + 1 or not rising or any(window < 0 for window in windows):
        sizes = f"windows {tuple(windows)} and edges_m {tuple(edges_m)}"
        raise ValueError(f"there must be increasing edges_m and one more window, none negative, got {sizes}")
    origin, target = (side.to(mask.device) for side in _moves(grid, tuple(windows), tuple(map(float, edges_m))))
    columns = mask.reshape(-1, grid.shape[0] * grid.shape[1], grid.shape[2])
    # sums, not assignments: several cells may mark the same one
    marks = columns.to(torch.int16)
    return marks.index_add(1, target, marks.index_select(1, origin)).bool().reshape(mask.shape)


@functools.lru_cache(maxsize=8)
def _moves(
    grid: Lattice, windows: tuple[int, ...], edges_m: tuple[float, ...]
) -> tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]:
    """Return pairs of columns as two tensors: one that marks, and one that it marks."""
    points = grid.centers(torch.float64)[:, :, 0].flatten(0, 1)
    distance_m = grid.distances_m().flatten()
    window = torch.tensor(windows)[torch.bucketize(distance_m, torch.tensor(edges_m, dtype=torch.float64), right=True)]
    step_m = grid.cell_m[0] if grid.periodic[1] else min(grid.cell_m[:2])
    pairs = [torch.zeros(0, 2, dtype=torch.int64)]
    for offset in [*range(-max(windows), 0), *range(1, max(windows) + 1)]:
        moved, inside = _moved(grid, points, distance_m, offset * step_m)
        origin = ((window >= abs(offset)) & inside).nonzero().flatten()
        pairs.append(torch.stack([origin, moved[origin]], dim=1))
    origin, target = torch.cat(pairs).unique(dim=0).unbind(1)
    return origin, target


def _moved(
    grid: Lattice, points: Float64[Tensor, "N 3"], distance_m: Float64[Tensor, " N"], by_m: float
) -> tuple[Int64[Tensor, " N"], Bool[Tensor, " N"]]:
    """Return the column of each point moved away from the axis, and whether it is in the grid, on the same side."""
    shift = torch.zeros_like(points)
    shift[:, :2] = points[:, :2] / distance_m.clamp(min=1e-9).unsqueeze(1) * by_m
    cell, inside = grid.flat_index(points + shift)
    return cell // grid.shape[2], inside & (distance_m + by_m > -1e-6)
