"""First hits of rays by tensor operations on any device, for all columns of a fan at once.

A column is all cells over one cell of x and y (or radius and azimuth), a level all cells of one height. Positions along
a ray are given by its parameter, see `rayiou.raycast.fans`.

The occupied levels of a column are the bits of one number, the levels that a ray crosses inside the column those of
another; the ray hits something in the first column where the two have a bit in common.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float64, Int64, UInt8
from torch import Tensor
from torch.nn import functional as F

from rayiou.labels import FREE
from rayiou.lattice import Lattice
from rayiou.raycast.crossings import FAR, TOUCH_M, clip_slab
from rayiou.raycast.fans import RayFans
from rayiou.raycast.trace import CHUNK_RAYS, Hits, clip, in_order, stack_ragged

MAX_LEVELS = 48
"""Largest number of levels of a mask, whose bits must fit into a float64."""


class Levels(NamedTuple):
    """The levels that the rays of fans are in, by parameter; masks have a bit for each level.

    Attributes:
        enter: parameter at which each ray enters each level; `FAR` for never.
        leave: parameter at which each ray leaves each level.
        params: parameters at which some ray of the fan enters or leaves a level, in order.
        entered: mask of the levels that each ray has entered after the first n of `params`.
        ahead: mask of the levels that it has not left after the first n of `params`.
    """

    enter: Float64[Tensor, "K E Z"]
    leave: Float64[Tensor, "K E Z"]
    params: Float64[Tensor, "K N"]
    entered: Int64[Tensor, "K N+1 E"]
    ahead: Int64[Tensor, "K N+1 E"]


def find_columns(
    grid: Lattice, origins: Float64[Tensor, "G 3"], azimuths: Float64[Tensor, "G 2"]
) -> tuple[Int64[Tensor, "G L"], Float64[Tensor, "G L+1"]]:
    """Return the columns along azimuths (horizontal vectors), L at most, in order; heights do not matter.

    They are given by their row-major index over the first two axes (where there is none, the number of the grid's
    columns), and by the parameter at which each column begins and the last one ends.
    """
    none = grid.shape[0] * grid.shape[1]
    # level rays at half the grid's height
    origins = F.pad(origins[:, :2], (0, 1), value=(grid.bounds[2][0] + grid.bounds[2][1]) / 2)
    directions = F.pad(azimuths, (0, 1))
    cells, ends = [], []
    for first in range(0, max(len(origins), 1), CHUNK_RAYS):
        chunk = slice(first, first + CHUNK_RAYS)
        start, leave = clip(grid, origins[chunk], directions[chunk])
        crossings = grid.crossings(origins[chunk], directions[chunk], start)[:2]
        cell, end = in_order(crossings, (grid.shape[1], 1), start, leave)
        # almost vertical rays leave so far away that rounding gives a cell beyond the grid
        cells.append(cell.masked_fill_((cell < 0) | (cell > none) | (end.diff(dim=1) <= TOUCH_M), none))
        ends.append(end)
    return stack_ragged(cells, none).long(), stack_ragged(ends, None)


def find_levels(grid: Lattice, fans: RayFans) -> Levels:
    """Return the levels that rays are in, of at most `MAX_LEVELS` levels."""
    (low, high), count = grid.bounds[2], grid.shape[2]
    edges = torch.linspace(low, high, count + 1, dtype=torch.float64, device=fans.origins.device)
    height, slope = fans.origins[:, 2].reshape(-1, 1, 1), fans.slopes.unsqueeze(-1)
    level = slope == 0
    crossed = (edges - height) / torch.where(level, 1.0, slope)
    within = torch.where((edges[:-1] <= height) & (height < edges[1:]), -FAR, FAR)
    enter = torch.where(level, within, torch.minimum(crossed[..., :-1], crossed[..., 1:]))
    leave = torch.where(level, FAR, torch.maximum(crossed[..., :-1], crossed[..., 1:]))
    params, order = torch.cat([enter + TOUCH_M, leave - TOUCH_M], dim=-1).flatten(1).sort(dim=1)
    elevation, event = order // (2 * count), order % (2 * count)
    bit = torch.ones_like(event) << (event % count)
    slot = torch.arange(1, params.shape[1] + 1, device=params.device).expand_as(params)
    slot = slot * slope.shape[1] + elevation
    behind = [
        torch.zeros(len(params), (params.shape[1] + 1) * slope.shape[1], dtype=torch.int64, device=params.device)
        .scatter_(1, slot, torch.where(is_kind, bit, 0))
        .reshape(len(params), params.shape[1] + 1, slope.shape[1])
        .cumsum(dim=1)
        for is_kind in (event < count, event >= count)
    ]
    return Levels(enter, leave, params, behind[0], ~behind[1])


class TensorTable:
    """Rays of one grid on any device, for grids of at most 48 levels; needs 8 bytes for every column of every ray."""

    def __init__(self, grid: Lattice, fans: RayFans):
        origins, azimuths = fans.azimuths.shape[:2]
        self.fans, self.levels, self.grid = fans, find_levels(grid, fans), grid
        columns = find_columns(grid, fans.origins.repeat_interleave(azimuths, dim=0), fans.azimuths.flatten(0, 1))
        self.cells, self.ends = (part.reshape(origins, azimuths, -1) for part in columns)
        self.masks = self._masks()

    def cast_all(self, volumes: Sequence[UInt8[Tensor, "X Y Z"]]) -> list[Hits]:
        """Return the first hits in each volume; see `RayTable.cast_all`."""
        rays = len(self.fans.order)
        first = torch.arange(len(self.ends), device=self.ends.device).unsqueeze(1) * rays
        place = (first + self.fans.order.argsort()).flatten()
        return [Hits(*(part.flatten()[place] for part in self._hits(labels))) for labels in volumes]

    def _masks(self) -> Int64[Tensor, "K A L E"]:
        """Return the mask of levels that each ray crosses inside each column."""
        origins, azimuths, ends = self.ends.shape
        params, entered, ahead = self.levels.params, self.levels.entered, self.levels.ahead
        rank = torch.searchsorted(params, self.ends.flatten(1), right=True).reshape(origins, azimuths, ends)
        fan = torch.arange(origins, device=rank.device).reshape(-1, 1, 1)
        return ahead[fan, rank[..., :-1]] & entered[fan, rank[..., 1:]]

    def _hits(self, labels: UInt8[Tensor, "X Y Z"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return cell, class, entry and exit distance of every ray, all (K, A, E)."""
        fans, levels = self.fans, labels.shape[2]
        bit = torch.ones_like(labels[0, 0], dtype=torch.int64) << torch.arange(levels, device=labels.device)
        bits = F.pad(((labels != FREE) * bit).sum(-1).flatten(), (0, 1))
        found = self.masks & bits[self.cells.long()].unsqueeze(-1)
        column = (found != 0).byte().argmax(dim=2)
        found = found.gather(2, column.unsqueeze(2)).squeeze(2)
        hit = found != 0
        level = _next_level(found, (fans.slopes > 0).unsqueeze(1))
        cells = torch.where(hit, self.cells.gather(2, column) * levels + level, -1)
        enter, leave = (part.unsqueeze(1).expand(*column.shape, levels) for part in self.levels[:2])
        entry = torch.maximum(self.ends.gather(2, column), enter.gather(3, level.unsqueeze(3)).squeeze(3))
        exit_ = torch.minimum(self.ends.gather(2, column + 1), leave.gather(3, level.unsqueeze(3)).squeeze(3))
        stretch, leave_m = fans.stretches.unsqueeze(1), self._leave_m()
        return (
            cells.int(),
            torch.where(hit, labels.flatten()[cells.clamp(min=0)], FREE),
            torch.where(hit, entry * stretch, leave_m).float(),
            torch.where(hit, exit_ * stretch, leave_m).float(),
        )

    def _leave_m(self) -> Tensor:
        """Return the distances (K, A, E) at which rays leave the grid; inf for those that miss it."""
        fans = self.fans
        enter, leave = clip_slab(fans.origins[:, 2:].expand_as(fans.slopes), fans.slopes, self.grid.bounds[2])
        first = torch.maximum(self.ends[..., :1], enter.unsqueeze(1))
        last = torch.minimum(self.ends[..., -1:], leave.unsqueeze(1))
        return (last * fans.stretches.unsqueeze(1)).masked_fill(last <= first + TOUCH_M, float("inf"))


def _next_level(found: Int64[Tensor, "K A E"], rising: Tensor) -> Int64[Tensor, "K A E"]:
    """Return the lowest level in a mask for rising rays, else the highest; 0 for none."""
    # the highest bit stays; the bits left below it are too small to round up to the next power of two
    single = torch.where(rising, found & -found, found & ~(found >> 1))
    exponent = (single.double().view(torch.int64) >> 52) - 1023
    return exponent.clamp_(min=0)
