"""Points in cells, and blocks of cells: a coarser grid over the same space, and conversions between the two."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Float64, Shaped
from torch import Tensor
from torch.nn import functional as F

from omniocc.geometry import Grid
from omniocc.model.ops.padding import Axes


def points_in_cells(geometry: Grid, places: Sequence[Sequence[float]]) -> Float64[Tensor, "K X Y Z 3"]:
    """Return points in every cell, ego frame, m, at fractions of the cell along each of the grid's axes."""
    edges = [geometry.edges(axis) for axis in range(3)]
    points = []
    for place in places:
        along = [low[:-1] + low.diff() * fraction for low, fraction in zip(edges, place, strict=True)]
        points.append(geometry.from_axes(*torch.meshgrid(*along, indexing="ij")))
    return torch.stack(points)


def as_block(cells: Sequence[int]) -> Axes:
    """Return the cells along each axis of a block; raise ValueError if they are not three positive numbers."""
    if len(cells) != 3 or min(cells) < 1:
        raise ValueError(f"block is {list(cells)}; it must be three positive numbers of cells")
    return cells[0], cells[1], cells[2]


def coarsened(geometry: Grid, block: Axes) -> Grid:
    """Return the grid whose cells are blocks of `geometry`'s.

    Raises:
        ValueError: if an axis does not divide into such blocks.
    """
    if any(size < 1 or cells % size for cells, size in zip(geometry.shape, block, strict=True)):
        shape = "x".join(map(str, geometry.shape))
        raise ValueError(f"a grid of {shape} cells does not divide into blocks of {'x'.join(map(str, block))}")
    shape = tuple(cells // size for cells, size in zip(geometry.shape, block, strict=True))
    return replace(geometry, shape=shape)  # type: ignore[type-var]


def block_any(mask: Bool[Tensor, "B X Y Z"], block: Axes) -> Bool[Tensor, "B x y z"]:
    """Return which blocks have a true cell."""
    x, y, z = (cells // size for cells, size in zip(mask.shape[1:], block, strict=True))
    return mask.reshape(-1, x, block[0], y, block[1], z, block[2]).any(-1).any(-2).any(-3)


def block_means(volume: Float[Tensor, "B C X Y Z"], block: Axes) -> Float[Tensor, "B C x y z"]:
    """Return the mean of every block, which reverses `repeat_blocks`."""
    return F.avg_pool3d(volume, block, block)


def repeat_blocks(volume: Shaped[Tensor, "B C x y z"], block: Axes) -> Shaped[Tensor, "B C X Y Z"]:
    """Copy the value of every block to its cells."""
    voxels = volume.movedim(1, -1)  # channels last in memory, which is fast in 3D convolutions
    for axis, count in enumerate(block, start=1):
        if count > 1:
            wide = voxels.unsqueeze(axis + 1)
            voxels = wide.expand(*wide.shape[: axis + 1], count, *wide.shape[axis + 2 :]).flatten(axis, axis + 1)
    return voxels.movedim(-1, 1)
