"""Exact traversal of a voxel grid by rays: every cell crossed, in order, with entry and exit distances.

All rays step from boundary to boundary together, in float64: Amanatides and Woo's algorithm (1987), where boundaries
may be planes, cylinders or half-planes (`omniocc.geometry.axes`).
"""

from collections.abc import Iterator
from math import prod
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Float32, Int32, Int64, UInt8
from torch import Tensor

from omniocc.classes import FREE
from omniocc.geometry.axes import TOUCH_M, Axis

CHUNK_RAYS = 1 << 15
"""Rays that step together; their state should stay in the processor's cache."""


@runtime_checkable
class Traversable(Protocol):
    """The part of a grid that tracing needs; see `omniocc.geometry.Grid`."""

    @property
    def shape(self) -> tuple[int, int, int]: ...  # noqa: D102

    def clip(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]: ...  # noqa: D102

    def axes(self, origins: Tensor, directions: Tensor, start_m: Tensor) -> tuple[Axis, Axis, Axis]: ...  # noqa: D102


class Paths(NamedTuple):
    """The cells that R rays cross, L at most.

    Attributes:
        cells: flat (row-major) cell index; -1 after the last cell and where a ray crosses the hole of a cylinder.
        bounds_m: distance along the ray at which the cell in the same column begins; the next column is where it ends.
        valid: whether the ray meets the grid at all, a cylinder's hole included.
    """

    cells: Int32[Tensor, "R L"]
    bounds_m: Float32[Tensor, "R L+1"]
    valid: Bool[Tensor, " R"]

    @property
    def entry_m(self) -> Float32[Tensor, "R L"]:
        """Distance at which each cell is entered; 0 for the cell that holds the origin."""
        return self.bounds_m[:, :-1]

    @property
    def exit_m(self) -> Float32[Tensor, "R L"]:
        """Distance at which each cell is left."""
        return self.bounds_m[:, 1:]


class Hits(NamedTuple):
    """Where R rays end.

    Attributes:
        cells: flat index of the cell hit; -1 for none.
        labels: its class; free for none.
        entry_m: distance at which it is entered; without a hit that at which the ray leaves the grid, and inf for a ray
            that never meets the grid.
        exit_m: distance at which it is left; otherwise as `entry_m`.
    """

    cells: Int32[Tensor, " R"]
    labels: UInt8[Tensor, " R"]
    entry_m: Float32[Tensor, " R"]
    exit_m: Float32[Tensor, " R"]

    @classmethod
    def nothing(cls, leave_m: Float32[Tensor, " R"]) -> "Hits":
        """Rays that leave the grid at these distances without a hit; inf if they never meet it."""
        cells = torch.full_like(leave_m, -1, dtype=torch.int32)
        return cls(cells, torch.full_like(leave_m, FREE, dtype=torch.uint8), leave_m.clone(), leave_m.clone())


class Stretch(NamedTuple):
    """The next cell of K rays.

    Attributes:
        rays: which rays.
        crossed: whether there is a next cell; the other columns mean nothing where there is none.
        cells: its flat index, or the number of cells in a cylinder's hole.
        entry_m: distance at which it is entered.
        exit_m: distance at which it is left.
    """

    rays: Int64[Tensor, " K"]
    crossed: Bool[Tensor, " K"]
    cells: Int64[Tensor, " K"]
    entry_m: Float[Tensor, " K"]
    exit_m: Float[Tensor, " K"]


def paths(grid: Traversable, origins: Float[Tensor, "R 3"], directions: Float[Tensor, "R 3"]) -> Paths:
    """Finds all cells that rays cross.

    Cells crossed over less than a nanometre are left out, so a ray through an edge goes from cell to opposite cell.

    Args:
        grid: cylinder or cuboid.
        origins: ego frame, metres; anywhere, inside or outside.
        directions: any length but zero.
    """
    steps: list[Stretch] = []
    count = torch.zeros(len(origins), dtype=torch.int64, device=origins.device)
    columns: list[Tensor] = []
    for stretch in walk(grid, origins, directions):
        crossed = stretch.crossed.nonzero().flatten()
        stretch = Stretch(*(part[crossed] for part in stretch))
        steps.append(stretch)
        columns.append(count[stretch.rays])
        count[stretch.rays] += 1
    length = int(count.max()) if len(count) else 0
    cells = torch.full((len(origins), length), -1, dtype=torch.int32, device=origins.device)
    bounds_m = torch.zeros(len(origins), length + 1, device=origins.device)
    for stretch, column in zip(steps, columns, strict=True):
        cells[stretch.rays, column] = torch.where(stretch.cells == prod(grid.shape), -1, stretch.cells).int()
        bounds_m[stretch.rays, column] = stretch.entry_m.float()
        bounds_m[stretch.rays, column + 1] = stretch.exit_m.float()
    after = torch.arange(length + 1, device=count.device) > count.unsqueeze(1)
    last_m = bounds_m.gather(1, count.unsqueeze(1))
    return Paths(cells, torch.where(after, last_m, bounds_m), count > 0)


def cast(
    grid: Traversable,
    labels: UInt8[Tensor, "X Y Z"],
    origins: Float[Tensor, "R 3"],
    directions: Float[Tensor, "R 3"],
) -> Hits:
    """Finds the first cell along each ray that is not free (0); unknown (255) is not free.

    Args:
        grid: cylinder or cuboid.
        labels: class of every cell.
        origins: ego frame, metres.
        directions: any length but zero.

    Raises:
        ValueError: if the labels do not have the grid's shape.
    """
    if labels.shape != grid.shape:
        raise ValueError(f"labels must have the grid's shape {grid.shape}, got {tuple(labels.shape)}")
    flat = torch.cat([labels.flatten(), labels.new_full((1,), FREE)])
    _, start_m, leave_m = _clip(grid, origins, directions)
    hits = Hits.nothing(torch.where(start_m < leave_m, leave_m, float("inf")).float())
    wanted = torch.ones(len(origins), dtype=torch.bool, device=origins.device)
    for stretch in walk(grid, origins, directions, wanted):
        label = flat.index_select(0, stretch.cells)
        stop = ((label != FREE) & stretch.crossed).nonzero().flatten()
        rays = stretch.rays[stop]
        hits.cells[rays] = stretch.cells[stop].int()
        hits.labels[rays] = label[stop]
        hits.entry_m[rays] = stretch.entry_m[stop].float()
        hits.exit_m[rays] = stretch.exit_m[stop].float()
        wanted[rays] = False
    return hits


def walk(
    grid: Traversable,
    origins: Float[Tensor, "R 3"],
    directions: Float[Tensor, "R 3"],
    wanted: Bool[Tensor, " R"] | None = None,
) -> Iterator[Stretch]:
    """Steps all rays through the grid, one cell at a time.

    Args:
        grid: cylinder or cuboid.
        origins: ego frame, metres.
        directions: any length but zero.
        wanted: rays to follow; the caller may clear entries between steps to stop rays.
    """
    for first in range(0, len(origins), CHUNK_RAYS):
        chunk = slice(first, first + CHUNK_RAYS)
        going = None if wanted is None else wanted[chunk]
        for stretch in _walk_chunk(grid, origins[chunk], directions[chunk], going):
            yield stretch._replace(rays=stretch.rays + first)


def _clip(grid: Traversable, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Unit directions, and where rays start and leave the grid; start >= leave for those that never meet it."""
    directions = torch.nn.functional.normalize(directions.double(), dim=-1, eps=0.0)
    enter_m, leave_m = grid.clip(origins.double(), directions)
    start_m = enter_m.clamp(min=0)
    return directions, start_m, torch.where(leave_m > start_m + TOUCH_M, leave_m, -1.0)


def _walk_chunk(
    grid: Traversable, origins: Tensor, directions: Tensor, wanted: Bool[Tensor, " R"] | None
) -> Iterator[Stretch]:
    directions, now_m, leave_m = _clip(grid, origins, directions)
    rays = (now_m < leave_m).nonzero().flatten()
    now_m, leave_m = now_m[rays], leave_m[rays]
    axes = grid.axes(origins[rays].double(), directions[rays], now_m)
    for axis in axes:
        axis.advance(axis.next_m <= now_m + TOUCH_M)
    while len(rays):
        end_m = torch.minimum(torch.minimum(axes[0].next_m, axes[1].next_m), torch.minimum(axes[2].next_m, leave_m))
        going = now_m < leave_m - TOUCH_M
        if wanted is not None:
            going &= wanted.index_select(0, rays)
        kept = going.nonzero().flatten()
        if 4 * len(kept) < 3 * len(rays):
            rays, now_m, end_m, leave_m = rays[kept], now_m[kept], end_m[kept], leave_m[kept]
            going = going[kept]
            for axis in axes:
                axis.keep(kept)
        reached_m = end_m + TOUCH_M
        crossed = going & (reached_m > now_m + 2 * TOUCH_M)
        yield Stretch(rays, crossed, _flat(axes, grid.shape, crossed), now_m, end_m)
        for axis in axes:
            axis.advance(axis.next_m <= reached_m)
        now_m = end_m


def _flat(axes: tuple[Axis, Axis, Axis], shape: tuple[int, int, int], crossed: Bool[Tensor, " K"]) -> Tensor:
    cell = (axes[0].index * shape[1] + axes[1].index) * shape[2] + axes[2].index
    return torch.where(crossed & (axes[0].index >= 0), cell, prod(shape)).long()
