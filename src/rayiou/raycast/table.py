"""First hits of rays that are cast repeatedly, or that have common origins and azimuths."""

import functools
from collections.abc import Sequence

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor

from rayiou.lattice import Lattice
from rayiou.raycast.crossings import Rays
from rayiou.raycast.fans import RayFans, RayScan
from rayiou.raycast.kernel_table import KernelTable
from rayiou.raycast.tensor_table import MAX_LEVELS, TensorTable
from rayiou.raycast.trace import Hits

CHUNK_SINGLE_RAYS = 1 << 14
"""Single rays that are cast together on a GPU."""


class RayTable:
    """Rays through one grid, prepared for casting through any labels.

    On a CPU the rays are cast by compiled kernels, elsewhere by tensor operations; cells and distances are the same.

    Raises:
        ValueError: if the grid has more than 48 levels.
    """

    def __init__(self, grid: Lattice, fans: RayFans):
        if grid.shape[2] > MAX_LEVELS:
            raise ValueError(f"rays are cast through at most {MAX_LEVELS} levels, got shape {grid.shape}; use paths()")
        self.shape, self.device = grid.shape, fans.origins.device
        self.table = KernelTable(grid, fans) if self.device.type == "cpu" else TensorTable(grid, fans)

    def cast(self, labels: UInt8[Tensor, "X Y Z"]) -> Hits:
        """Return the first cell along each ray that is not free (0); unknown (255) is not free.

        Raises:
            ValueError: if the labels do not have the grid's shape.
        """
        return self.cast_all([labels])[0]

    def cast_all(self, volumes: Sequence[UInt8[Tensor, "X Y Z"]]) -> list[Hits]:
        """Return the results of `cast` for several label volumes, at less cost than one after the other.

        Raises:
            ValueError: when labels do not have the shape of the grid.
        """
        for labels in volumes:
            if labels.shape != self.shape:
                raise ValueError(f"labels must have the grid's shape {self.shape}, got {tuple(labels.shape)}")
        return self.table.cast_all(volumes)

    @functools.cached_property
    def reach_m(self) -> Float32[Tensor, " R"]:
        """Return the distance (m) at which each ray leaves the grid; inf if it misses the grid."""
        return self.cast(torch.zeros(self.shape, dtype=torch.uint8, device=self.device)).exit_m


def cast(grid: Lattice, labels: UInt8[Tensor, "X Y Z"], origins: Rays, directions: Rays) -> Hits:
    """Return the first cell along each ray that is not free (0); unknown (255) is not free.

    For rays that form a LiDAR raster, or that stay the same, `ray_table` is many times faster. Origins are in the ego
    frame, in metres; directions may have any length above 0.

    Raises:
        ValueError: if the labels do not have the grid's shape.
    """
    chunk_rays = max(len(origins), 1) if origins.device.type == "cpu" else CHUNK_SINGLE_RAYS
    parts = []
    for first in range(0, max(len(origins), 1), chunk_rays):
        chunk = slice(first, first + chunk_rays)
        parts.append(RayTable(grid, RayFans.single(origins[chunk], directions[chunk])).cast(labels))
    return Hits(*(torch.cat(part) for part in zip(*parts, strict=True)))


def ray_table(grid: Lattice, origins: Float[Tensor, "O 3"], scan: RayScan) -> RayTable:
    """Return prepared rays, from a cache of the last few tables.

    Args:
        grid: cylinder or cuboid; equal grids use one table.
        origins: ego frame, metres; the table lives on their device.
        scan: directions from each origin; the table's rays are in the order of `RayScan.rays`.
    """
    return _cached(grid, origins.double().cpu().numpy().tobytes(), scan, str(origins.device))


@functools.lru_cache(maxsize=4)
def _cached(grid: Lattice, origins: bytes, scan: RayScan, device: str) -> RayTable:
    starts = torch.frombuffer(bytearray(origins), dtype=torch.float64).reshape(-1, 3).to(device)
    return RayTable(grid, scan.fans(starts))
