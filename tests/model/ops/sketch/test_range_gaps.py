import math

import pytest
import torch

from omniocc.camera import Equirectangular
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.sketch.range_gaps import RangeGaps, cell_samples

GRID = Cylinder((8, 12, 4), (0.0, 8.0), (-2.0, 2.0))
PANORAMA = Equirectangular(24, 8, 45.0, -45.0)


def test_one_sample_is_the_centre():
    assert torch.allclose(cell_samples(GRID, [1, 1, 1])[0], GRID.centers(torch.float64))


def test_samples_lie_in_their_cells_evenly():
    for grid in (GRID, Cuboid((6, 5, 4))):
        samples = cell_samples(grid, [2, 1, 3])
        assert samples.shape == (6, *grid.shape, 3)
        index, inside = grid.index(samples)
        assert inside.all()
        assert (index == index[:1]).all()
    heights = cell_samples(GRID, [1, 1, 4])[:, 3, 5, 2, 2]
    assert heights.tolist() == pytest.approx([0.125, 0.375, 0.625, 0.875])


@pytest.mark.parametrize("grid", [GRID, Cuboid((6, 5, 4), (-8.0, 8.0), (-8.0, 8.0), (-2.0, 2.0))])
def test_against_loops(grid):
    per_axis = [1, 2, 2]
    range_m = torch.rand(2, 8, 24) * 8 + 0.5
    valid = torch.rand(2, 8, 24) < 0.8
    result = RangeGaps(grid, PANORAMA, per_axis)(range_m, valid)
    points = cell_samples(grid, per_axis)
    for sample, x, y, z in [(0, 0, 0, 0), (1, 5, 4, 3), (0, 3, 2, 1), (1, 2, 3, 2), (1, 4, 1, 2)]:
        sums = [0.0] * 4
        for px, py, pz in points[:, x, y, z].tolist():
            azimuth, elevation = math.atan2(py, px), math.atan2(pz, math.hypot(px, py))
            column = math.floor((math.pi - azimuth) / (2 * math.pi) * 24) % 24
            row = math.floor((45 - math.degrees(elevation)) / 90 * 8)
            if not 0 <= row < 8 or not valid[sample, row, column]:
                continue
            seen, distance = float(range_m[sample, row, column]), math.sqrt(px * px + py * py + pz * pz)
            gap = (seen - distance) / grid.cell_m[0]
            parts = [1.0, gap, gap / 4, math.log(seen / distance)]
            sums = [total + max(-1.0, min(1.0, part)) for total, part in zip(sums, parts, strict=True)]
        assert result[sample, :, x, y, z].tolist() == pytest.approx([total / 4 for total in sums], abs=1e-4)


def test_in_front_at_and_behind_a_wall_all_around():
    walls = RangeGaps(GRID, PANORAMA, [1, 1, 1])(torch.full((1, 8, 24), 4.5), torch.ones(1, 8, 24, dtype=torch.bool))
    outwards = walls[0, 1, :, 0, 2]  # z 0.5 m: the elevation of the first cell is 45 degrees
    assert (outwards[1:3] == 1).all()
    assert (outwards[5:] == -1).all()
    assert float(outwards[4]) == pytest.approx(4.5 - math.hypot(4.5, 0.5), abs=1e-5)


def test_without_a_valid_range_nothing_is_known():
    gaps = RangeGaps(GRID, PANORAMA, [1, 2, 2])
    assert not gaps(torch.full((2, 8, 24), 3.0), torch.zeros(2, 8, 24, dtype=torch.bool)).any()
    steep = gaps(torch.full((1, 8, 24), 3.0), torch.ones(1, 8, 24, dtype=torch.bool))[0, :, 0, :, 0]
    assert not steep.any()  # all samples of the innermost lowest cells are below the panorama


def test_not_finite_where_invalid_does_no_harm():
    range_m = torch.full((1, 8, 24), torch.nan)
    range_m[:, :, 12:] = math.inf
    assert RangeGaps(GRID, PANORAMA, [1, 1, 1])(range_m, torch.zeros(1, 8, 24, dtype=torch.bool)).isfinite().all()
