"""First hits of rays that are cast repeatedly, or that have common origins and azimuths.

On a CPU the compiled kernels of `raycast.march` cast them in several threads, elsewhere tensor operations do.
"""

import functools
import itertools
import math
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int64, UInt8
from torch import Tensor
from torch.nn import functional as F

from rayiou.labels import FREE
from rayiou.lattice import Lattice
from rayiou.raycast import march
from rayiou.raycast.crossings import FAR, TOUCH_M, Rays, clip_slab
from rayiou.raycast.fans import RayFans, RayScan
from rayiou.raycast.trace import CHUNK_RAYS, Hits, clip, in_order, stack_ragged

CHUNK_SINGLE_RAYS = 1 << 14
"""Single rays that are cast together on a GPU."""
RAYS_PER_TASK = 2000
"""Approximate number of rays of one task of a thread; less work is not worth a thread."""
MAX_LEVELS = 48
"""Largest number of levels of a mask, whose bits must fit into a float64."""


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
        parts.append(RayTable(grid, RayFans.from_rays(origins[chunk], directions[chunk])).cast(labels))
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


class KernelTable:
    """Rays of one grid on a CPU.

    The first call in a process loads the compiled kernels; the first on a machine compiles them and keeps the result in
    the package's `__pycache__`, else in numba's cache folder (`NUMBA_CACHE_DIR` if set). As many threads as
    `torch.get_num_threads()` allows do the work. They are started and joined by each call, and no thread pool of
    numba is used: calls from several threads and from forked processes are safe.

    Columns of cells are kept only from the second call on: prediction and truth of a frame are cast in one call, and
    most origins never occur again.
    """

    def __init__(self, grid: Lattice, fans: RayFans):
        self.fans = fans
        bottom, top = grid.bounds[2]
        enter, leave = clip_slab(fans.origins[:, 2:].expand_as(fans.slopes), fans.slopes, (bottom, top))
        spans = torch.stack([enter.amin(1), leave.amax(1)], dim=1)
        parts = (fans.origins, fans.azimuths, fans.slopes, fans.stretches, fans.order, spans)
        self.rays = tuple(part.contiguous().numpy() for part in parts)
        is_cylinder = grid.periodic[1]
        edges = torch.linspace(bottom, top, grid.shape[2] + 1, dtype=torch.float64).numpy()
        self.grid = (
            edges,
            np.array(grid.bounds[:2]),
            grid.shape[:2],
            sector_faces(grid.shape[1] if is_cylinder else 0),
        )
        # the most columns along an azimuth: rings are crossed twice, half of the sectors' faces once
        self.longest = 3 + (2 * grid.shape[0] + (grid.shape[1] + 1) // 2 if is_cylinder else sum(grid.shape[:2]))
        self.uses, self.kept = 0, None

    def cast_all(self, volumes: Sequence[UInt8[Tensor, "X Y Z"]]) -> list[Hits]:
        """Return the first hits in each volume; see `RayTable.cast_all`."""
        groups, rays = math.prod(self.fans.azimuths.shape[:2]), len(self.fans.origins) * len(self.fans.order)
        columns = self.grid[2][0] * self.grid[2][1]
        # numpy copies: torch would leave a thread spinning on a core that the kernels need
        labels = np.stack([labels.contiguous().numpy().reshape(columns, -1) for labels in volumes])
        dtypes = (torch.int32, torch.uint8, torch.float32, torch.float32)
        found = [torch.empty(len(volumes), rays, dtype=dtype) for dtype in dtypes]
        out = tuple(part.numpy() for part in found)
        self.uses += 1
        if self.uses == 1:
            bits = np.empty((len(labels), columns), dtype=np.int64)
            march.pack(labels, bits)
            run_in_threads(
                lambda *part: march.cast(*part, self.rays, self.grid, self.longest, labels, packed=bits, out=out),
                groups,
                rays,
            )
        else:
            for number, volume in enumerate(labels):
                self._cast_kept(volume, tuple(part[number] for part in out), groups, rays)
        return [Hits(*row) for row in zip(*found, strict=True)]

    def _cast_kept(self, labels: np.ndarray, out: tuple[np.ndarray, ...], groups: int, rays: int) -> None:
        kept = self._kept(groups, rays)
        run_in_threads(lambda *part: march.cast_kept(*part, self.rays, self.grid, kept, labels, out), groups, rays)

    def _kept(self, groups: int, rays: int) -> tuple[np.ndarray, ...]:
        if self.kept is None:
            cells, ends = np.empty((groups, self.longest - 1), dtype=np.int32), np.empty((groups, self.longest))
            turn = np.uint16 if self.longest < 1 << 15 else np.uint32
            turns = np.empty((groups, self.fans.slopes.shape[1], len(self.grid[0])), dtype=turn)
            kept = cells, ends, np.empty(groups, dtype=np.int64), turns
            run_in_threads(lambda *part: march.build(*part, self.rays, self.grid, kept), groups, rays)
            used = int(kept[2].max(initial=0)) + 1
            self.kept = (cells[:, : used - 1].copy(), ends[:, :used].copy(), *kept[2:])
        return self.kept


def sector_faces(sectors: int) -> np.ndarray:
    """Return sine and cosine of the sectors' faces, twice around, then both in opposite order: (4, 2 sectors)."""
    angle = torch.linspace(-math.pi, math.pi, sectors + 1, dtype=torch.float64)[:-1].repeat(2)
    twice = torch.stack([angle.sin(), angle.cos()])
    return torch.cat([twice, twice.flip(1)]).numpy()


def run_in_threads(work: Callable[[int, int], object], groups: int, rays: int) -> None:
    """Call `work(first, last)` for ranges that cover 0 .. groups-1, in as many threads as torch may use."""
    threads = torch.get_num_threads()
    tasks = max(1, min(groups, rays // RAYS_PER_TASK, 8 * threads))
    ranges = list(itertools.pairwise(groups * i // tasks for i in range(tasks + 1)))
    failed: list[BaseException] = []

    def run() -> None:
        try:
            while not failed:
                work(*ranges.pop())  # the interpreter's lock makes pop atomic; the kernels release the lock
        except IndexError:
            return
        except BaseException as error:  # raised again below, in the calling thread
            failed.append(error)

    helpers = [threading.Thread(target=run) for _ in range(min(threads, tasks) - 1)]
    for helper in helpers:
        helper.start()
    run()
    for helper in helpers:
        helper.join()
    if failed:
        raise failed[0]


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
    """Rays of one grid on any device, all columns of a fan at once.

    A column is all cells over one cell of x and y (or radius and azimuth), a level all cells of one height. The
    occupied levels of a column are the bits of one number, the levels that a ray crosses inside the column those of
    another; the ray hits something in the first column where the two have a bit in common. Grids have at most 48
    levels, and every column of every ray needs 8 bytes.
    """

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
