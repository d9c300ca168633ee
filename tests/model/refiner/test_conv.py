"""Tests of both refiners with a pyramid of levels."""

import itertools

import pytest
import torch

from omniocc.extras.rivals import ChannelToHeight
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.refiner import Conv
from omniocc.model.sketch import Sketched

SKETCHED = Sketched(torch.ones(1, 1, 1, 1, dtype=torch.bool))
CYLINDER, CUBOID = Cylinder((6, 8, 4)), Cuboid((5, 6, 3))


def conv(geometry, channels, blocks):
    return Conv(geometry, 4, channels, blocks)


def channel_to_height(geometry, channels, blocks):
    return ChannelToHeight(geometry, 4, 5, channels, blocks)


@pytest.fixture(params=[conv, channel_to_height])
def build(request):
    return request.param


@torch.no_grad()
@pytest.mark.parametrize("roll", [2, 6])
def test_rotating_the_world_rotates_the_volume(build, roll):
    refiner = build(CYLINDER, [8, 16], [1, 2]).double()
    volume = torch.randn(1, 4, *CYLINDER.shape, dtype=torch.float64)
    rolled = refiner(volume.roll(roll, dims=3), SKETCHED)
    torch.testing.assert_close(rolled, refiner(volume, SKETCHED).roll(roll, dims=3))


def test_a_block_sees_two_cells_around_and_across_the_seam(build):
    geometry = Cylinder((9, 12, 7))
    refiner = build(geometry, [8], [1])
    for module in refiner.modules():  # the norm depends on the whole sample
        if isinstance(module, torch.nn.GroupNorm):
            module.forward = lambda volume: volume
    volume = torch.randn(1, 4, *geometry.shape, requires_grad=True)
    refiner(volume, SKETCHED)[0, :, 4, 1, 3].sum().backward()
    reached = {tuple(cell) for cell in volume.grad.abs().sum((0, 1)).nonzero().tolist()}
    heights = range(7) if build is channel_to_height else range(1, 6)  # each view sees whole columns
    assert reached == set(itertools.product(range(2, 7), (11, 0, 1, 2, 3), heights))


def test_training_reaches_every_parameter_on_odd_sizes(build):
    refiner = build(CUBOID, [8, 8, 16], [1, 1, 1])
    output = refiner(torch.randn(2, 4, *CUBOID.shape), SKETCHED)
    assert output.shape == (2, refiner.channels, *CUBOID.shape)
    (output * torch.randn_like(output)).sum().backward()
    for name, parameter in refiner.named_parameters():
        assert parameter.grad.abs().sum() > 0, name


@pytest.mark.parametrize(
    ("geometry", "channels", "blocks", "message"),
    [
        (CYLINDER, [8, 8], [1], "one number each"),
        (CYLINDER, [], [], "one number each"),
        (Cylinder((4, 6, 2)), [8, 8, 8], [1, 1, 1], "multiples of 4.* 6"),
        (CUBOID, [8, 12], [1, 1], "multiple of 8"),
    ],
)
def test_sizes_that_do_not_fit_are_named(build, geometry, channels, blocks, message):
    with pytest.raises(ValueError, match=message):
        build(geometry, channels, blocks)
