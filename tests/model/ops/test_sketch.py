import math

import pytest
import torch
from torch.nn import functional as F

from omniocc.camera import Equirectangular
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.padding import Conv3d
from omniocc.model.ops.sketch import (
    AsymmetricBlock,
    Context,
    Cylinder3D,
    PointEncoder,
    RangeGaps,
    cell_samples,
    point_features,
    pseudo_points,
    voxel_max,
)

PANORAMA = Equirectangular(24, 6, 45.0, -45.0)
GRID = Cylinder((8, 12, 4), (0.0, 8.0), (-2.0, 2.0))
VIEW = Equirectangular(24, 8, 45.0, -45.0)
NETWORK_GRID = Cylinder((8, 12, 4))


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
            feature = point_features(point[None], grid.scaled(point[None]), grid)
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
    assert point_features(point, grid.scaled(point), grid)[0].tolist() == pytest.approx(expected, abs=1e-5)


def test_turning_the_points_by_whole_cells_turns_the_features():
    grid = Cylinder((8, 12, 4))
    encoder = PointEncoder(grid, 8)
    points = (torch.rand(1, 300, 3) - 0.5) * torch.tensor([50.0, 50.0, 6.0])
    turn = 5 * 2 * math.pi / 12
    cos, sin = math.cos(turn), math.sin(turn)
    turned = points @ torch.tensor([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    assert torch.allclose(encoder(turned)[0], encoder(points)[0].roll(5, dims=3), atol=1e-4)


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
    result = RangeGaps(grid, VIEW, per_axis)(range_m, valid)
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
    walls = RangeGaps(GRID, VIEW, [1, 1, 1])(torch.full((1, 8, 24), 4.5), torch.ones(1, 8, 24, dtype=torch.bool))
    outwards = walls[0, 1, :, 0, 2]  # z 0.5 m: the elevation of the first cell is 45 degrees
    assert (outwards[1:3] == 1).all()
    assert (outwards[5:] == -1).all()
    assert float(outwards[4]) == pytest.approx(4.5 - math.hypot(4.5, 0.5), abs=1e-5)


def test_without_a_valid_range_nothing_is_known():
    gaps = RangeGaps(GRID, VIEW, [1, 2, 2])
    assert not gaps(torch.full((2, 8, 24), 3.0), torch.zeros(2, 8, 24, dtype=torch.bool)).any()
    steep = gaps(torch.full((1, 8, 24), 3.0), torch.ones(1, 8, 24, dtype=torch.bool))[0, :, 0, :, 0]
    assert not steep.any()  # all samples of the innermost lowest cells are below the panorama


def test_not_finite_where_invalid_does_no_harm():
    range_m = torch.full((1, 8, 24), torch.nan)
    range_m[:, :, 12:] = math.inf
    assert RangeGaps(GRID, VIEW, [1, 1, 1])(range_m, torch.zeros(1, 8, 24, dtype=torch.bool)).isfinite().all()


def test_convolution_wraps_around_and_pads_with_zeros():
    conv = Conv3d(3, 5, (3, 5, 1), NETWORK_GRID.periodic)
    volume = torch.randn(2, 3, 8, 12, 4)
    repeated = torch.cat([volume] * 3, dim=3)
    expected = F.conv3d(repeated, conv.weight, conv.bias, padding=(1, 0, 0))[:, :, :, 10:22]
    assert torch.allclose(conv(volume), expected, atol=1e-5)


def test_rolling_by_the_stride_rolls_the_output():
    network = Cylinder3D(NETWORK_GRID, 3, [8, 16, 16], 2)
    volume = torch.randn(1, 3, 8, 12, 4)
    for cells in (4, 8):
        assert torch.allclose(network(volume.roll(cells, 3)), network(volume).roll(cells, 3), atol=1e-5)
    assert not torch.allclose(network(volume.roll(4, 2)), network(volume).roll(4, 2), atol=1e-3)


def test_a_batch_of_two_is_two_batches_of_one(geometry):
    network = Cylinder3D(geometry, 3, [8, 8], 2)
    volume = torch.randn(2, 3, *geometry.shape)
    assert torch.allclose(network(volume), torch.cat([network(volume[:1]), network(volume[1:])]), atol=1e-5)


def test_gradients_reach_every_parameter(geometry):
    network = Cylinder3D(geometry, 3, [8, 16, 16], 2)
    network(torch.randn(1, 3, *geometry.shape)).square().sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.any(), name


def test_blocks_reach_as_far_as_their_kernels_say():
    def reach(block):
        for module in block.modules():  # the norm depends on the whole sample
            if isinstance(module, torch.nn.GroupNorm):
                module.forward = lambda volume: volume
        volume = torch.randn(1, 8, *NETWORK_GRID.shape, requires_grad=True)
        block(volume)[0, :, 4, 6, 2].sum().backward()
        touched = volume.grad.abs().sum((0, 1)).nonzero() - torch.tensor([4, 6, 2])
        return {tuple(cell) for cell in touched.tolist()}

    box = {(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-2, -1, 0, 1)}  # z ends at +1
    assert reach(AsymmetricBlock(8, 8, NETWORK_GRID.periodic)) == box
    cross = {(0, 0, 0)} | {tuple(step * (i == axis) for i in range(3)) for axis in range(3) for step in (-1, 1)}
    assert reach(Context(8, NETWORK_GRID.periodic)) == cross


def test_gates_of_context_are_half_open_without_weights_and_open_far_above_zero():
    context, volume = Context(8, NETWORK_GRID.periodic), torch.randn(2, 8, *NETWORK_GRID.shape)
    for norm, bias, expected in ((0.0, 0.0, 1.5), (0.0, 30.0, 3.0), (0.0, -90.0, 0.0)):
        for part in context.norms:
            torch.nn.init.constant_(part.weight, norm)
            torch.nn.init.constant_(part.bias, bias)
        torch.testing.assert_close(context(volume), expected * volume)


@pytest.mark.parametrize("shape", [(7, 12, 3), (5, 8, 1)])
def test_other_axes_may_be_odd(shape):
    assert Cylinder3D(Cylinder(shape), 3, [8, 8, 8], 2)(torch.randn(1, 3, *shape)).shape == (1, 2, *shape)
    assert Cylinder3D(Cuboid(shape), 3, [8, 8, 8], 2)(torch.randn(1, 3, *shape)).shape == (1, 2, *shape)


def test_impossible_sizes_are_named():
    with pytest.raises(ValueError, match=r"multiples of 8.* 12"):
        Cylinder3D(NETWORK_GRID, 3, [8, 8, 8, 8], 2)
    with pytest.raises(ValueError, match="12 channels"):
        Cylinder3D(NETWORK_GRID, 3, [12, 8], 2)
