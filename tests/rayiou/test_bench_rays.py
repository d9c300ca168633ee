"""Tests of the benchmark of rays: it runs, and its floor counts cells and columns."""

import importlib.util
from pathlib import Path

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder, RayScan

PATH = Path(__file__).parents[1] / "bench" / "bench_rays.py"


@pytest.fixture(scope="module")
def bench():
    spec = importlib.util.spec_from_file_location("bench_rays", PATH)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "grid", [Cylinder((8, 12, 4), (0.0, 8.0), (-2.0, 2.0)), Cuboid((8, 8, 4), (-8.0, 8.0), (-8.0, 8.0), (-2.0, 2.0))]
)
def test_every_figure_is_measured(bench, grid, capsys):
    found = bench.measure(grid, RayScan(torch.eye(3)), repeats=1)
    assert list(found) == ["all cells", "fresh", "static", "scattered"]
    assert all(rate > 0 for rate in found.values())
    assert bench.measure_update(grid, repeats=1) > 0
    assert "Mray/s" in capsys.readouterr().out


def test_the_floor_counts_cells_and_columns_up_to_the_hit(bench):
    grid = Cuboid((8, 8, 4), (-8.0, 8.0), (-8.0, 8.0), (-2.0, 2.0))
    labels = torch.zeros(grid.shape, dtype=torch.uint8)
    labels[6] = 4
    # from cell 4 ahead: cells 4, 5, 6; upwards: two levels of one column
    scan = RayScan(torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    floor = bench.find_floor(grid, labels, torch.tensor([[0.5, 0.5, 0.5]], dtype=torch.float64), scan, 1)
    assert (floor.cells, floor.columns, floor.column_bytes) == (3 + 2, 3 + 1, 16)
