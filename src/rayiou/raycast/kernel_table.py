"""First hits of rays on a CPU: the compiled kernels of `raycast.march` for tensors, in several threads."""

import itertools
import math
import threading
from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from rayiou.lattice import Lattice
from rayiou.raycast import march
from rayiou.raycast.crossings import clip_slab
from rayiou.raycast.fans import RayFans
from rayiou.raycast.trace import Hits

RAYS_PER_TASK = 2000
"""Approximate number of rays of one task of a thread; less work is not worth a thread."""


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
                lambda *part: march.cast(*part, self.rays, self.grid, self.longest, labels, bits, out), groups, rays
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
