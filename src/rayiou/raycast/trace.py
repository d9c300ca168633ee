"""Exact traversal of a voxel grid by rays: every cell crossed, in order, with entry and exit distances.

The crossings with all boundaries of all axes (`raycast.crossings`) are put in order of distance, in float64;
each changes the cell by one along its axis.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float32, Float64, Int32, UInt8
from torch import Tensor

from rayiou.lattice import Lattice
from rayiou.raycast.crossings import FAR, TOUCH_M, Crossings, Rays

CHUNK_RAYS = 1024
"""Rays whose crossings are sorted together, few enough for the processor's cache."""


class RayPaths(NamedTuple):
    """The cells that R rays cross, L at most.

    Attributes:
        cells: flat (row-major) cell index; -1 after the last cell and where a ray crosses the hole of a cylinder.
        bounds_m: distance along the ray at which the cell in the same column begins; the next column is where it ends.
        valid: whether the ray enters the grid, a cylinder's hole included.
    """

    cells: Int32[Tensor, "R L"]
    bounds_m: Float32[Tensor, "R L+1"]
    valid: Bool[Tensor, " R"]

    @property
    def entry_m(self) -> Float32[Tensor, "R L"]:
        """Return the distance at which each cell is entered; 0 for the cell that holds the origin."""
        return self.bounds_m[:, :-1]

    @property
    def exit_m(self) -> Float32[Tensor, "R L"]:
        """Return the distance at which each cell is left."""
        return self.bounds_m[:, 1:]


class Hits(NamedTuple):
    """First hits of R rays.

    Attributes:
        cells: flat index of the cell hit; -1 for none.
        labels: class of the cell hit; free for none.
        entry_m: distance at which the cell is entered; without a hit the distance at which the ray leaves the grid, and
            inf for a ray that misses the grid.
        exit_m: distance at which the cell is left; without a hit the same as `entry_m`.
    """

    cells: Int32[Tensor, " R"]
    labels: UInt8[Tensor, " R"]
    entry_m: Float32[Tensor, " R"]
    exit_m: Float32[Tensor, " R"]


def paths(grid: Lattice, origins: Rays, directions: Rays) -> RayPaths:
    """Return all cells that rays cross.

    Cells crossed over less than a nanometre are left out, so a ray through an edge goes from cell to opposite cell.
    Origins are in the ego frame, in metres, inside or outside the grid; directions may have any length above 0.
    """
    chunks = range(0, max(len(origins), 1), CHUNK_RAYS)
    parts = [_paths(grid, origins[i : i + CHUNK_RAYS], directions[i : i + CHUNK_RAYS]) for i in chunks]
    cells, bounds_m, valid = zip(*parts, strict=True)
    return RayPaths(stack_ragged(cells, -1), stack_ragged(bounds_m, None), torch.cat(valid))


def _paths(grid: Lattice, origins: Rays, directions: Rays) -> RayPaths:
    origins, directions = origins.double(), unit(directions)
    start_m, leave_m = clip(grid, origins, directions)
    _, second, third = grid.shape
    strides = (second * third, third, 1)
    cells, bounds_m = in_order(grid.crossings(origins, directions, start_m), strides, start_m, leave_m)
    ray, segment = (bounds_m.diff(dim=1) > TOUCH_M).nonzero().unbind(-1)
    count = torch.bincount(ray, minlength=len(origins))
    column = torch.arange(len(ray), device=ray.device) - (count.cumsum(0) - count)[ray]
    length = int(count.max()) if len(count) else 0
    packed = cells.new_full((len(origins), length), -1)
    packed[ray, column] = cells[ray, segment].clamp(min=-1)
    packed_m = leave_m.float().unsqueeze(1).repeat(1, length + 1)
    packed_m[ray, column] = bounds_m[ray, segment].float()
    return RayPaths(packed, packed_m, count > 0)


def unit(directions: Rays) -> Float64[Tensor, "R 3"]:
    """Return the directions with length 1."""
    return torch.nn.functional.normalize(directions.double(), dim=-1, eps=0.0)


def clip(
    grid: Lattice, origins: Float64[Tensor, "R 3"], directions: Float64[Tensor, "R 3"]
) -> tuple[Float64[Tensor, " R"], Float64[Tensor, " R"]]:
    """Return the distances at which rays start in the grid and leave it; equal for those that miss it."""
    enter_m, leave_m = grid.clip(origins, directions)
    start_m, leave_m = enter_m.clamp(min=0), leave_m.clamp(max=FAR)
    enters = leave_m > start_m + TOUCH_M
    return torch.where(enters, start_m, 0.0), torch.where(enters, leave_m, 0.0)


def in_order(
    crossings: Sequence[Crossings],
    strides: Sequence[int],
    start_m: Float64[Tensor, " R"],
    leave_m: Float64[Tensor, " R"],
) -> tuple[Int32[Tensor, "R N"], Float64[Tensor, "R N+1"]]:
    """Return the crossings of several axes in order: the cell of each stretch between two, and the stretches' ends.

    `strides` are those of the axes in a flat cell index, which is negative in a cylinder's hole. Crossings beyond
    `leave_m` are moved to it. Some stretches have no length.
    """
    at_m = torch.cat([axis.at_m for axis in crossings], dim=1).clamp_(start_m.unsqueeze(1), leave_m.unsqueeze(1))
    at_m, order = at_m.sort(dim=1, stable=True)
    last = int((at_m < leave_m.unsqueeze(1)).sum(dim=1).max()) if len(at_m) else 0
    step = torch.cat([axis.step * stride for axis, stride in zip(crossings, strides, strict=True)], dim=1)
    first = sum(axis.index * stride for axis, stride in zip(crossings, strides, strict=True))
    assert isinstance(first, Tensor)
    cells = torch.cat([first.int().unsqueeze(1), step.gather(1, order[:, :last])], dim=1)
    cells = cells.cumsum(dim=1, dtype=torch.int32)
    return cells, torch.cat([start_m.unsqueeze(1), at_m[:, :last], leave_m.unsqueeze(1)], dim=1)


def stack_ragged(parts: Sequence[Tensor], fill: int | None) -> Tensor:
    """Return tables of different width stacked, filled on the right with a number or, for None, their last column."""
    table = parts[0].new_empty(sum(len(part) for part in parts), max(part.shape[1] for part in parts))
    for part, rows in zip(parts, table.split([len(part) for part in parts]), strict=True):
        rows[:, : part.shape[1]] = part
        rows[:, part.shape[1] :] = part[:, -1:] if fill is None else fill
    return table
