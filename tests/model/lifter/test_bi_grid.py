import itertools
import math

import pytest
import torch
from by_hand import bilinear, middle_of

from omniocc.extras.rivals import BiGrid
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.static import static_shapes
from omniocc.model.sketch import Sketched

CUBOID = Cuboid((4, 5, 3), (-9.0, 8.0), (-7.0, 10.0), (-3.0, 4.0))
CYLINDER = Cylinder((3, 7, 2), (0.0, 8.0), (-3.0, 3.0))
PAIRS = pytest.mark.parametrize(("first", "second"), [(CUBOID, CYLINDER), (CYLINDER, CUBOID), (CYLINDER, None)])
SIZES = [(9, 16), (5, 8)]


def make(first, second):
    return BiGrid(first, second, 8, 5, [4, 8]).double()


def make_features(batch=1):
    return [torch.randn(batch, 6, 8, *size, dtype=torch.float64) for size in SIZES]


def candidates(grid, batch=1):
    return Sketched(torch.zeros(batch, *grid.shape, dtype=torch.bool))


def cell_at(grid, point):
    """The cell that holds a point, or None outside, by hand."""
    x, y, z = point.tolist()
    values = (math.hypot(x, y), math.atan2(y, x), z) if isinstance(grid, Cylinder) else (x, y, z)
    cell = [
        math.floor((value - low) / (high - low) * cells)
        for value, cells, (low, high) in zip(values, grid.shape, grid.bounds, strict=True)
    ]
    return tuple(cell) if all(0 <= k < cells for k, cells in zip(cell, grid.shape, strict=True)) else None


def sample_by_hand(grid, cell, features, maps, rig):
    """The feature of one cell of a grid: mean over the cameras that see its middle, sum over levels."""
    pixels, valid = rig.project(middle_of(grid, cell))
    total, seen = torch.zeros(5, dtype=torch.float64), valid.nonzero()[:, 0].tolist()
    for camera, (level, linear) in itertools.product(seen, zip(features, maps, strict=True)):
        u, v = pixels[camera].tolist()
        height, width = level.shape[-2:]
        column = (u + 0.5) * width / rig.cameras[camera].width - 0.5
        row = (v + 0.5) * height / rig.cameras[camera].height - 0.5
        total += linear.weight @ bilinear(level[camera].permute(1, 2, 0), column, row)
    return total / max(len(seen), 1)


@torch.no_grad()
@PAIRS
def test_equals_loops_over_cells_cameras_and_levels(fisheye, first, second):
    lifter, features = make(first, second), make_features()
    own = [level[0] for level in features]
    volume, beyond = lifter(features, candidates(first), (fisheye,))[0], 0
    for cell in itertools.product(*map(range, first.shape)):
        parts = [sample_by_hand(first, cell, own, lifter.maps[0], fisheye)]
        if second is not None:
            other = cell_at(second, middle_of(first, cell))
            beyond += other is None
            found = None if other is None else sample_by_hand(second, other, own, lifter.maps[1], fisheye)
            parts.append(torch.zeros(5, dtype=torch.float64) if found is None else found)
        expected = lifter.mix.weight @ torch.cat(parts) + lifter.mix.bias
        # reference points are kept in float32
        torch.testing.assert_close(volume[(slice(None), *cell)], expected, rtol=1e-5, atol=1e-5)
    assert beyond > 0 or second is not CYLINDER


@torch.no_grad()
@PAIRS
def test_batch_with_different_rigs_equals_single_samples(fisheye, pinhole, make_ring, first, second):
    lifter, features = make(first, second), make_features(4)
    rigs = (fisheye, pinhole, make_ring(4), fisheye)
    volumes = lifter(features, candidates(first, 4), rigs)
    for index, rig in enumerate(rigs):
        alone = lifter([level[index : index + 1] for level in features], candidates(first), (rig,))
        torch.testing.assert_close(volumes[index], alone[0])
        with static_shapes():
            torch.testing.assert_close(
                lifter([level[index : index + 1] for level in features], candidates(first), (rig,)), alone
            )


@PAIRS
def test_training_reaches_every_parameter_and_every_map(fisheye, first, second):
    lifter = make(first, second)
    features = [level.requires_grad_() for level in make_features(2)]
    volume = lifter(features, candidates(first, 2), (fisheye, fisheye))
    (volume * torch.randn_like(volume)).sum().backward()
    for tensor in (*features, *lifter.parameters()):
        assert tensor.grad.abs().sum() > 0


def test_a_rig_with_other_cameras_than_the_images_is_named(fisheye):
    with pytest.raises(ValueError, match=r"6 cameras.*images.* 4"):
        make(CUBOID, None)([level[:, :4] for level in make_features()], candidates(CUBOID), (fisheye,))
