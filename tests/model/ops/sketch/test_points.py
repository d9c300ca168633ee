import math

import pytest
import torch

from omniocc.camera import Equirectangular
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.sketch.points import PointEncoder, point_features, pseudo_points, voxel_max

PANORAMA = Equirectangular(24, 6, 45.0, -45.0)


def test_points_lie_where_the_pixels_look():
    range_m = torch.rand(2, 6, 24) * 20 + 1
    points = pseudo_points(range_m, torch.ones(2, 6, 24, dtype=torch.bool), PANORAMA)
    row, column = 1, 5
    azimuth = math.pi - (column + 0.5) * 2 * math.pi / 24
    elevation = math.radians(45 - (row + 0.5) * 90 / 6)
    direction = [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    expected = [float(range_m[1, row, column]) * part for part in direction]
    assert points[1, row * 24 + column].tolist() == pytest.approx(expected, rel=1e-5)


def test_invalid_pixels_have_no_point():
    valid = torch.rand(1, 6, 24) < 0.5
    points = pseudo_points(torch.ones(1, 6, 24), valid, PANORAMA)
    assert torch.equal(points.isfinite().all(-1), valid.flatten(1))


def test_maximum_of_each_cell_against_loops():
    features = torch.randn(200, 5, dtype=torch.float64)
    cells = torch.randint(0, 40, (200,))
    result = voxel_max(features, cells, 50)
    for cell in range(50):
        inside = [features[i] for i in range(200) if cells[i] == cell]
        for channel in range(5):
            assert float(result[cell, channel]) == max([0.0, *(float(point[channel]) for point in inside)])


@pytest.mark.parametrize("grid", [Cylinder((8, 12, 4)), Cuboid((8, 8, 4))], ids=["cylinder", "cuboid"])
def test_encoder_against_loops(grid):
    encoder = PointEncoder(grid, 8).double()
    points = (torch.rand(2, 60, 3, dtype=torch.float64) - 0.5) * torch.tensor([50.0, 50.0, 8.0])
    points[0, 3] = torch.nan
    volume, hit = encoder(points)
    expected = torch.zeros_like(volume)
    seen = torch.zeros_like(hit)
    for sample in range(2):
        for point in points[sample]:
            cell, inside = grid.index(point)
            if not inside:
                continue
            x, y, z = cell.tolist()
            feature = point_features(point[None], grid)
            encoded = encoder.out(encoder.hidden(feature).relu()).relu()[0]
            expected[sample, :, x, y, z] = torch.maximum(expected[sample, :, x, y, z], encoded)
            seen[sample, 0, x, y, z] = 1
    assert torch.allclose(volume, expected)
    assert torch.equal(hit, seen)


def test_features_of_a_point_by_hand():
    grid = Cylinder((8, 12, 4), (0.0, 8.0), (-2.0, 2.0))
    # r 2.25 m: cell 2; azimuth 40 degrees: 220/30 = 7.33 cells; height 0.5 m: 2.5 cells
    azimuth = math.radians(40)
    point = torch.tensor([[2.25 * math.cos(azimuth), 2.25 * math.sin(azimuth), 0.5]])
    expected = [-0.25, 1 / 3 - 0.5, 0.0, 2.25 / 4 - 1, 0.25, math.hypot(2.25, 0.5) / 7.5]
    assert point_features(point, grid)[0].tolist() == pytest.approx(expected, abs=1e-5)


def test_turning_the_points_by_whole_cells_turns_the_features():
    grid = Cylinder((8, 12, 4))
    encoder = PointEncoder(grid, 8)
    points = (torch.rand(1, 300, 3) - 0.5) * torch.tensor([50.0, 50.0, 6.0])
    turn = 5 * 2 * math.pi / 12
    cos, sin = math.cos(turn), math.sin(turn)
    turned = points @ torch.tensor([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    assert torch.allclose(encoder(turned)[0], encoder(points)[0].roll(5, dims=3), atol=1e-4)
