"""Columns of cells (over x and y, or radius and azimuth) and levels (cells along z) that fans of rays cross.

Positions along a ray are given by its parameter, see `omniocc.geometry.raycast.fans`.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float64, Int64
from torch import Tensor
from torch.nn import functional as F

from omniocc.geometry.raycast.crossings import FAR, TOUCH_M
from omniocc.geometry.raycast.fans import Fans
from omniocc.geometry.raycast.trace import CHUNK_RAYS, Traversable, clip, in_order, stack_ragged

MAX_LEVELS = 48
"""Largest number of levels of a mask, whose bits must fit into a float64."""


class Columns(NamedTuple):
    """The columns of cells along G azimuths, L at most, in order.

    Attributes:
        cells: row-major index over the first two axes of the nth column along each azimuth; where there is none, the
            number of the grid's columns.
        ends: parameter at which each column begins and the last one ends.
    """

    cells: Int64[Tensor, "G L"]
    ends: Float64[Tensor, "G L+1"]


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


def find_columns(grid: Traversable, origins: Float64[Tensor, "G 3"], azimuths: Float64[Tensor, "G 2"]) -> Columns:
    """Return the columns along azimuths (horizontal vectors); heights do not matter."""
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
    return Columns(stack_ragged(cells, none).long(), stack_ragged(ends, None))


def find_levels(grid: Traversable, fans: Fans) -> Levels:
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
