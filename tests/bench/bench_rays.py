"""Measure rays per second through the paper's grids: `python tests/bench/bench_rays.py [threads] [repeats]`.

14,040 rays from each of 8 origins, one at the ego origin and seven spread over the grid.

* 'all cells' lists every cell of every ray (`Grid.paths`).
* 'fresh' finds first hits from new origins, including the making of the table (`RayTable(...).cast`).
* 'static' finds first hits from the same origins in new labels (`RayTable.cast`).
* 'scattered' finds first hits of rays without common origins or azimuths (`Grid.cast`).

The floor is the work that no method can avoid that looks up all cells before the hit: a byte per cell, or by columns,
as here, a mask of the ray and the bits of the column for each column. 'Floor' is the time of a single sequential pass
over those bytes with one `and` for each column.
"""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch

sys.path.insert(0, str(Path(__file__).parents[2] / "src"))

from omniocc.geometry import Cuboid, Cylinder, RayScan, RayTable
from omniocc.metric import RayIoU, sparseocc_directions

ROAD_CELLS = 2
CLUTTER = 0.01
PAPER = (Cylinder((128, 200, 16)), Cuboid((256, 256, 16)))
SOME_RAYS = 4000


class Time(NamedTuple):
    """Seconds of some work: the best and the median of the repeats."""

    best_s: float
    median_s: float


class Floor(NamedTuple):
    """Least work for the first hits of some rays."""

    cells: int
    columns: int
    column_bytes: int
    best_s: float


def scene(grid: Cylinder | Cuboid) -> torch.Tensor:
    """Return labels with road everywhere and clutter in one cell of a hundred."""
    labels = torch.zeros(grid.shape, dtype=torch.uint8)
    labels[torch.rand(grid.shape, generator=torch.Generator().manual_seed(0)) < CLUTTER] = 4
    labels[..., :ROAD_CELLS] = 1
    return labels


def spiral_origins(reach_m: float) -> torch.Tensor:
    """Return the ego origin and seven points on a spiral to 55 % of the grid's reach."""
    angle = torch.arange(8, dtype=torch.float64) * 0.8
    return torch.stack([angle.cos(), angle.sin(), 0 * angle], dim=-1) * (angle * 0.1 * reach_m).unsqueeze(1)


def timed(work: Callable[[], object], repeats: int) -> Time:
    """Return the time of some work, after one run that does not count."""
    work()
    spent = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        spent.append(time.perf_counter() - start)
    return Time(min(spent), statistics.median(spent))


def find_floor(
    grid: Cylinder | Cuboid, labels: torch.Tensor, origins: torch.Tensor, scan: RayScan, repeats: int
) -> Floor:
    """Count cells and columns up to the first hit on the paths of all rays, and time a pass over their bytes."""
    hits = RayTable(grid, scan.fans(origins)).cast(labels)
    cells = columns = 0
    for place, entry_m in zip(origins, hits.entry_m.reshape(len(origins), -1), strict=True):
        found = grid.paths(place.expand(len(scan), 3), scan.directions)
        crossed = (found.cells >= 0) & (found.entry_m <= entry_m.unsqueeze(1))
        column = torch.where(crossed, found.cells // grid.shape[2], -1)
        cells += int(crossed.sum())
        columns += int((crossed[:, :1]).sum() + (crossed[:, 1:] & (column.diff(dim=1) != 0)).sum())
    masks = torch.ones(columns, dtype=torch.int16)
    bits, result = masks.clone(), masks.clone()
    pass_ = timed(lambda: torch.bitwise_and(masks, bits, out=result), repeats)
    return Floor(cells, columns, 4 * columns, pass_.best_s)


def measure(grid: Cylinder | Cuboid, scan: RayScan, repeats: int) -> dict[str, float]:
    """Print one block; return Mray/s (best) by name."""
    origins, labels = spiral_origins(grid.bounds[0][1]), scene(grid)
    rays = len(origins) * len(scan)
    starts, directions = scan.rays(origins)
    some = torch.randperm(rays, generator=torch.Generator().manual_seed(0))[:SOME_RAYS]
    starts, directions = starts[some], directions[some]
    table = RayTable(grid, scan.fans(origins))
    table.cast(labels)  # masks are kept from the second look-up on
    works: list[tuple[str, int, Callable[[], object]]] = [
        ("all cells", len(some), lambda: grid.paths(starts, directions)),
        ("fresh", rays, lambda: RayTable(grid, scan.fans(origins)).cast(labels)),
        ("static", rays, lambda: table.cast(labels)),
        ("scattered", len(some), lambda: grid.cast(labels, starts, directions)),
    ]
    floor = find_floor(grid, labels, origins, scan, repeats)
    threads, best_ms = torch.get_num_threads(), floor.best_s * 1e3
    print(f"{type(grid).__name__} {grid.shape}, {rays} rays from {len(origins)} origins, {threads} threads")
    print(f"  to the first hit {floor.cells / rays:.1f} cells and bytes per ray, {floor.columns / rays:.1f} columns")
    print(
        f"  floor {floor.column_bytes / 1e6:.1f} MB in {best_ms:.2f} ms = {rays / best_ms / 1e3:.0f} Mray/s", flush=True
    )
    found = {}
    for name, count, work in works:
        spent = timed(work, repeats)
        found[name], median = count / spent.best_s / 1e6, count / spent.median_s / 1e6
        floors = spent.best_s / count * rays / floor.best_s
        print(f"  {name:9} {found[name]:8.3f} Mray/s, median {median:8.3f}; {floors:6.1f} floors", flush=True)
    return found


def measure_update(grid: Cylinder | Cuboid, repeats: int) -> float:
    """Print and return ms per frame (best) of RayIoU from the ego origin, the default."""
    metric, frame = RayIoU(grid), scene(grid).unsqueeze(0)
    spent = timed(lambda: metric.update(frame.roll(1, 1), frame), repeats)
    text = f"{spent.best_s * 1e3:.1f} ms per frame, median {spent.median_s * 1e3:.1f}"
    print(f"RayIoU.update, {type(grid).__name__} {grid.shape}, ego origin: {text}")
    return spent.best_s * 1e3


def measure_published(repeats: int) -> float:
    """Print and return Mray/s (best) of the published setting: all rays of 8 new origins, in prediction and truth."""
    grid = Cuboid((200, 200, 16), x_m=(-40, 40), y_m=(-40, 40), height_m=(-1, 5.4))
    metric, truth = RayIoU.sparseocc(grid), scene(grid).unsqueeze(0)
    truth = torch.where(truth == 0, 17, truth)  # the published class of free cells
    origins = spiral_origins(40.0).unsqueeze(0)
    moved = iter(range(repeats + 1))  # to other origins in every frame, as along a drive
    spent = timed(lambda: metric.update(truth.roll(1, 1), truth, origins + 0.1 * next(moved)), repeats)
    rays = 2 * origins.shape[1] * len(sparseocc_directions())
    found = rays / spent.best_s / 1e6
    print(f"RayIoU.sparseocc.update, 8 origins: {1 / spent.best_s:.0f} frames/s, {found:.1f} Mray/s in two volumes")
    return found


def main(threads: int = 2, repeats: int = 15) -> None:
    """Print one block per grid."""
    torch.set_num_threads(threads)
    scan = RayScan(sparseocc_directions())
    for grid in PAPER:
        measure(grid, scan, repeats)
    for grid in (Cylinder((64, 100, 8)), *PAPER):
        measure_update(grid, repeats)
    measure_published(repeats)


if __name__ == "__main__":
    main(*(int(value) for value in sys.argv[1:]))
