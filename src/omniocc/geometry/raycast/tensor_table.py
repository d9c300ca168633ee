"""First hits of rays by tensor operations on any device, for all columns of a fan at once.

The occupied levels of a column are the bits of one number, the levels that a ray crosses inside the column those of
another; the ray hits something in the first column where the two have a bit in common.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from omniocc.classes import FREE
from omniocc.geometry.raycast.columns import find_columns, find_levels
from omniocc.geometry.raycast.crossings import TOUCH_M, clip_slab
from omniocc.geometry.raycast.fans import Fans
from omniocc.geometry.raycast.trace import Hits, Traversable


class TensorTable:
    """Rays of one grid on any device, for grids of at most 48 levels; needs 8 bytes for every column of every ray."""

    def __init__(self, grid: Traversable, fans: Fans):
        origins, azimuths = fans.azimuths.shape[:2]
        self.fans, self.levels, self.grid = fans, find_levels(grid, fans), grid
        found = find_columns(grid, fans.origins.repeat_interleave(azimuths, dim=0), fans.azimuths.flatten(0, 1))
        self.cells = found.cells.reshape(origins, azimuths, -1)
        self.ends = found.ends.reshape(origins, azimuths, -1)
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
        bits = torch.nn.functional.pad(((labels != FREE) * bit).sum(-1).flatten(), (0, 1))
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
