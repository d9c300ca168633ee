"""Rays that stay the same from frame to frame: their cells are found once, a frame then only looks up labels."""

import functools

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from omniocc.classes import FREE
from omniocc.geometry.trace import Hits, Paths, Traversable, paths

BLOCK = 16
"""Cells of a ray that are looked up together; a ray that has hit something does not read its next block."""


class RayTable:
    """The cells of R fixed rays through one grid, in blocks of `BLOCK` cells.

    Args:
        found: the rays' cells (`Grid.paths`).
        num_cells: cells in the grid.
    """

    def __init__(self, found: Paths, num_cells: int):
        self.valid, self.bounds_m, self.num_cells = found.valid, found.bounds_m, num_cells
        padded = torch.nn.functional.pad(found.cells, (0, -found.cells.shape[1] % BLOCK), value=-1)
        # the label behind the last cell is free
        padded = torch.where(padded < 0, num_cells, padded)
        self.blocks = [block.contiguous() for block in padded.split(BLOCK, dim=1)]

    def cast(self, labels: UInt8[Tensor, "X Y Z"]) -> Hits:
        """Finds the first cell along each ray that is not free (0); the same as `Grid.cast` with these rays.

        Raises:
            ValueError: if the number of labels is not that of the grid's cells.
        """
        if labels.numel() != self.num_cells:
            raise ValueError(f"labels must have {self.num_cells} cells, got shape {tuple(labels.shape)}")
        flat = torch.cat([labels.flatten(), labels.new_full((1,), FREE)])
        column = torch.full_like(self.valid, self.bounds_m.shape[1] - 1, dtype=torch.int64)
        hits = Hits.nothing(self._bound(column))
        going = self.valid.nonzero().flatten()
        for number, block in enumerate(self.blocks):
            cells = block.index_select(0, going)
            seen = flat.index_select(0, cells.flatten()).reshape(cells.shape)
            stop = seen.view(torch.int64).any(dim=1)
            rows = stop.nonzero().flatten()
            rays, seen = going[rows], seen[rows]
            first = (seen != FREE).to(torch.uint8).argmax(dim=1, keepdim=True)
            column[rays] = first.flatten() + number * BLOCK
            hits.labels[rays] = seen.gather(1, first).flatten()
            hits.cells[rays] = cells[rows].gather(1, first).flatten()
            going = going[~stop]
            if not len(going):
                break
        return hits._replace(entry_m=self._bound(column), exit_m=self._bound(column + (hits.cells >= 0)))

    def _bound(self, column: Tensor) -> Tensor:
        distance = self.bounds_m.gather(1, column.unsqueeze(1)).flatten()
        return torch.where(self.valid, distance, float("inf"))


def ray_table(grid: Traversable, origins: Float[Tensor, "R 3"], directions: Float[Tensor, "R 3"]) -> RayTable:
    """Finds the cells of fixed rays, or takes them from the last few tables that were asked for.

    Args:
        grid: cylinder or cuboid; equal grids share a table.
        origins: ego frame, metres; the table lives on their device.
        directions: any length but zero.
    """
    rays = torch.stack([origins, directions]).double()
    return _cached(grid, rays.cpu().numpy().tobytes(), str(rays.device))


@functools.lru_cache(maxsize=8)
def _cached(grid: Traversable, rays: bytes, device: str) -> RayTable:
    origins, directions = torch.frombuffer(bytearray(rays), dtype=torch.float64).reshape(2, -1, 3).to(device)
    return RayTable(paths(grid, origins, directions), grid.shape[0] * grid.shape[1] * grid.shape[2])
