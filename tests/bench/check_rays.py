"""Check rays against brute force on many random grids: `python tests/bench/check_rays.py [rays] [seed]`.

For every ray all crossings with all surfaces are computed in float64 and sorted; the midpoint between two of them gives
the cell (`reference` in tests/rayiou/raycast/test_trace.py). Cells must agree in number and order; the largest
difference of a distance is printed. First hits in random labels, by the compiled kernels and by tensors, must be the
first occupied cell of the path. Some rays are vertical or level, start on faces, on the axis or outside, or pass
through the axis.
"""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import torch

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "src"))

from omniocc.geometry import Cuboid, Cylinder  # noqa: E402
from rayiou.raycast.fans import RayFans  # noqa: E402
from rayiou.raycast.table import TensorTable  # noqa: E402

RAYS_PER_GRID = 1000


def load(name: str) -> ModuleType:
    """Return a test module of tests/rayiou/raycast."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "tests" / "geometry" / "raycast" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def random_grid(generator: torch.Generator) -> Cylinder | Cuboid:
    """Return a grid of up to 24 x 36 x 12 cells; half of the cylinders have a hole, no cuboid is centred."""

    def number(low: float, high: float) -> float:
        return low + (high - low) * torch.rand((), generator=generator, dtype=torch.float64).item()

    def count(low: int, high: int) -> int:
        return int(torch.randint(low, high + 1, (), generator=generator))

    height_m = (number(-4, -0.5), number(0.5, 4))
    if count(0, 1):
        hole_m = number(0.5, 4) * count(0, 1)
        return Cylinder((count(1, 24), count(3, 36), count(1, 12)), (hole_m, hole_m + number(2, 20)), height_m)
    spans = [(number(-15, -2), number(2, 15)) for _ in range(2)]
    return Cuboid((count(1, 24), count(1, 24), count(1, 12)), spans[0], spans[1], height_m)


def random_rays(grid: Cylinder | Cuboid, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Return origins and directions, with special cases among them."""
    shape = (RAYS_PER_GRID, 3)
    origins = (torch.rand(shape, generator=generator, dtype=torch.float64) - 0.5) * torch.tensor([50.0, 50.0, 9.0])
    directions = torch.randn(shape, generator=generator, dtype=torch.float64)
    directions[::2, 2] *= 0.1
    kind = torch.arange(RAYS_PER_GRID) % 20
    origins[kind >= 6] *= 0.4  # most of them inside
    directions[kind == 0, :2] = 0
    directions[kind == 1, 2] = 0
    directions[kind == 2, 1:] = 0
    origins[kind == 3] = 0
    directions[kind == 4, :2] = -origins[kind == 4, :2] / 7  # through the axis
    on_face = (kind == 5).nonzero().flatten()
    axis = int(torch.randint(3, (), generator=generator))
    edges = grid.edges(axis)[:-1]
    values = list(grid.to_axes(origins[on_face]))
    values[axis] = edges[torch.randint(len(edges), (len(on_face),), generator=generator)]
    origins[on_face] = grid.from_axes(*values)
    return origins, directions


def check_grid(seed: int, compare: Callable[..., float], first_hits: Callable[..., tuple]) -> float:
    """Check one grid; return the largest difference of a distance in metres."""
    generator = torch.Generator().manual_seed(seed)
    grid = random_grid(generator)
    origins, directions = random_rays(grid, generator)
    worst = compare(grid, origins, directions)
    labels = torch.randint(1, 12, grid.shape, generator=generator, dtype=torch.uint8)
    labels[torch.rand(grid.shape, generator=generator) < torch.rand((), generator=generator)] = 0
    expected = first_hits(grid, labels, origins, directions)
    on_tensors = TensorTable(grid, RayFans.from_rays(origins, directions)).cast_all([labels])[0]
    for hits in (grid.cast(labels, origins, directions), on_tensors):
        assert torch.equal(hits.cells, expected[0]), (seed, grid)
        assert torch.equal(hits.labels, expected[1]), (seed, grid)
        for found_m, expected_m in ((hits.entry_m, expected[2]), (hits.exit_m, expected[3])):
            finite = expected_m.isfinite()
            assert torch.equal(finite, found_m.isfinite()), (seed, grid)
            worst = max(worst, (found_m - expected_m)[finite].abs().amax().item() if finite.any() else 0.0)
    return worst


def main(rays: int = 300_000, seed: int = 0) -> None:
    """Check as many grids as this number of rays needs."""
    torch.set_num_threads(1)
    compare, first_hits = load("test_trace").compare, load("test_table").first_hits
    grids = -(-rays // RAYS_PER_GRID)
    worst = max(check_grid(seed + i, compare, first_hits) for i in range(grids))
    print(f"{grids * RAYS_PER_GRID} rays through {grids} grids: same cells, distances within {worst:.1e} m")


if __name__ == "__main__":
    main(*(int(value) for value in sys.argv[1:]))
