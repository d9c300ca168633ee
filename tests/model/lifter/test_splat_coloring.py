import itertools

import pytest
import torch

from omniocc.extras.rivals import SplatColoring
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.lifter.lift_splat import bin_points
from omniocc.model.sketch import Sketched

CYLINDER, CUBOID = Cylinder((4, 8, 3)), Cuboid((6, 4, 3))
GRIDS = pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])
BLOCK = (2, 2, 1)
SIZES = [(9, 16), (5, 8)]
RANGES_M = torch.arange(6, dtype=torch.float64) * 4 + 2.5


def make(geometry, block=BLOCK):
    lifter = SplatColoring(geometry, 8, 5, [4, 8], 6, (0.5, 24.5), block, 1, 2, 2, 8).double()
    for layer in lifter.coloring.layers:  # away from the special values at which training begins
        torch.nn.init.normal_(layer.attention.offsets.weight, std=0.2)
        torch.nn.init.normal_(layer.attention.attention.weight, std=0.2)
    return lifter


def make_features(batch=1):
    return [torch.randn(batch, 6, 8, *size, dtype=torch.float64) for size in SIZES]


def splat_by_loops(lifter, geometry, features, rig):
    """One sample, a pixel and a bin at a time: (5, X, Y, Z)."""
    fine, coarse = features
    maps = torch.nn.functional.adaptive_avg_pool2d(fine, coarse.shape[-2:]) + coarse
    points_m, seen = bin_points(rig, 5, 8, RANGES_M)
    volume = torch.zeros(5, *geometry.shape, dtype=torch.float64)
    places = itertools.product(range(6), range(5), range(8))
    for pixel, (camera, row, column) in enumerate(places):
        found = lifter.splat.split(maps[camera, :, row, column])
        weights = found[:6].exp() / found[:6].exp().sum()
        for point, weight in zip(points_m[pixel], weights, strict=True):
            cell, inside = geometry.index(point)
            if seen[pixel] and inside:
                volume[(slice(None), *cell.tolist())] += weight * found[6:]
    return volume


@torch.no_grad()
@GRIDS
def test_equals_splatting_by_loops_and_what_blocks_find(fisheye, geometry):
    lifter, features = make(geometry), make_features()
    volume = splat_by_loops(lifter, geometry, [level[0] for level in features], fisheye)
    x, y, z = geometry.shape
    queries = torch.zeros(8, x // 2, y // 2, z, dtype=torch.float64)
    for i, j, k in itertools.product(range(x // 2), range(y // 2), range(z)):
        mean = sum(volume[:, 2 * i + a, 2 * j + b, k] for a, b in itertools.product(range(2), range(2))) / 4
        queries[:, i, j, k] = lifter.query.weight @ mean + lifter.query.bias
    everywhere = torch.ones(1, *queries.shape[1:], dtype=torch.bool)
    # `Coloring` is compared with loops in its own test
    found = lifter.coloring.color(features, everywhere, (fisheye,), start=queries[None])[0]
    expected = volume.clone()
    for i, j, k in itertools.product(range(x), range(y), range(z)):
        expected[:, i, j, k] += lifter.found.weight @ found[:, i // 2, j // 2, k] + lifter.found.bias
    nothing = Sketched(torch.zeros(1, *geometry.shape, dtype=torch.bool))
    torch.testing.assert_close(lifter(features, nothing, (fisheye,))[0], expected)


@torch.no_grad()
@GRIDS
def test_batch_with_different_rigs_equals_single_samples(fisheye, pinhole, make_ring, geometry):
    lifter, features = make(geometry), make_features(batch=3)
    rigs = (fisheye, pinhole, make_ring(4))
    candidates = torch.ones(3, *geometry.shape, dtype=torch.bool)
    volumes = lifter(features, Sketched(candidates), rigs)
    for index, rig in enumerate(rigs):
        part = slice(index, index + 1)
        alone = lifter([level[part] for level in features], Sketched(candidates[part]), (rig,))
        torch.testing.assert_close(volumes[index], alone[0])
    assert not torch.allclose(volumes[0], volumes[1])


def test_training_reaches_every_parameter(fisheye):
    lifter = make(CUBOID).float()
    features = [level.float() for level in make_features(2)]
    candidates = torch.ones(2, *CUBOID.shape, dtype=torch.bool)
    volume = lifter(features, Sketched(candidates), (fisheye, fisheye))
    (volume * torch.randn_like(volume)).sum().backward()
    for name, parameter in lifter.named_parameters():
        # every block has a query, so the vector for blocks without one is not used
        assert parameter.grad.abs().sum() > 0 or name == "coloring.empty", name


@pytest.mark.parametrize(
    ("block", "message"), [((2, 2), "three positive"), ((2, 0, 1), "three positive"), ((4, 4, 1), "divide")]
)
def test_blocks_that_do_not_fit_are_named(block, message):
    with pytest.raises(ValueError, match=message):
        make(CUBOID, block)


def test_range_logits_are_those_of_the_splat(fisheye):
    lifter, features = make(CUBOID), make_features()
    assert torch.equal(lifter.range_logits(features), lifter.splat.range_logits(features))
