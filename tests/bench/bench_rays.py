"""Rays per second through the paper's grids, on this machine: `python tests/bench/bench_rays.py [threads]`.

14,040 rays from each of 8 origins, seven of them spread over the grid and one at the ego origin. 'paths' finds all
cells of all rays, 'cast' steps only as far as the first hit, 'static' looks hits up in cells found before. The floor is
what no method gets around: the cells up to the first hit, one byte gathered for each.
"""

import sys
import time
from collections.abc import Callable

import torch

from omniocc.geometry import Cuboid, Cylinder, Grid, RayTable
from omniocc.metric import RayIoU, sparseocc_directions

ROAD_CELLS = 2
CLUTTER = 0.01


def scene(grid: Grid) -> torch.Tensor:
    """Road everywhere, clutter in one cell of a hundred."""
    labels = torch.zeros(grid.shape, dtype=torch.uint8)
    labels[torch.rand(grid.shape) < CLUTTER] = 4
    labels[..., :ROAD_CELLS] = 1
    return labels


def rays() -> tuple[torch.Tensor, torch.Tensor]:
    """8 x 14,040 rays."""
    directions = sparseocc_directions()
    angle = torch.arange(8) * 0.8
    origins = torch.stack([angle * 2.5 * angle.cos(), angle * 2.5 * angle.sin(), 0 * angle], dim=-1)
    return origins.repeat_interleave(len(directions), dim=0), directions.repeat(8, 1)


def seconds(work: Callable[[], object], repeats: int) -> float:
    """The fastest of some repeats, after one that does not count."""
    work()
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return best


def main() -> None:
    """Prints one block per grid."""
    torch.manual_seed(0)
    torch.set_num_threads(int(sys.argv[1]) if len(sys.argv) > 1 else 2)
    origins, directions = rays()
    for grid in (Cylinder((128, 200, 16)), Cuboid((256, 256, 16))):
        labels = scene(grid)
        found = grid.paths(origins, directions)
        table = RayTable(found, grid.num_cells)
        hits = table.cast(labels)
        crossed = (found.cells >= 0) & (found.entry_m <= hits.entry_m.unsqueeze(1))
        print(f"{type(grid).__name__} {grid.shape}, {len(origins)} rays, {torch.get_num_threads()} threads")
        cells, visited = int((found.cells >= 0).sum()), int(crossed.sum())
        print(f"  cells crossed {cells / 1e6:.1f} M; floor: {visited / 1e6:.1f} M cells and bytes up to the first hit")
        for name, work, repeats in (
            ("paths ", lambda grid=grid: grid.paths(origins, directions), 1),
            ("cast  ", lambda grid=grid, labels=labels: grid.cast(labels, origins, directions), 2),
            ("static", lambda table=table, labels=labels: table.cast(labels), 10),
        ):
            print(f"  {name} {len(origins) / seconds(work, repeats) / 1e6:8.3f} Mray/s")
    for shape in ((64, 100, 8), (128, 200, 16)):
        grid = Cylinder(shape)
        metric, frame = RayIoU(grid), scene(grid).unsqueeze(0)
        spent = seconds(lambda metric=metric, frame=frame: metric.update(frame.roll(1, 1), frame), 20)
        print(f"RayIoU.update, cylinder {shape}, ego origin: {spent * 1e3:.1f} ms per frame")


if __name__ == "__main__":
    main()
