import itertools
import math

import pytest
import torch

from omniocc.extras.rivals import Focus
from omniocc.extras.rivals.focus import EndAttention, end_features
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.sketch import Sketched

SKETCHED = Sketched(torch.ones(1, 1, 1, 1, dtype=torch.bool))
CYLINDER, CUBOID = Cylinder((5, 8, 3)), Cuboid((4, 5, 3))
GRIDS = pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])


def make(geometry):
    refiner = Focus(geometry, 4, [8, 8], [1, 1]).double()
    torch.nn.init.normal_(refiner.lengths.weight, std=0.3)
    return refiner


def ends_by_loops(volume, lengths, periodic):
    """Features at the ends of all runs of one sample, a voxel and a direction at a time: (6, X, Y, Z, C)."""
    channels, *shape = volume.shape
    ends = torch.zeros(6, *shape, channels, dtype=volume.dtype)
    for cell in itertools.product(*map(range, shape)):
        for direction in range(6):
            axis, sign = direction // 2, 1 - 2 * (direction % 2)
            cells = shape[axis]
            position = cell[axis] + sign * cells * float(lengths[(direction, *cell)])
            if not periodic[axis]:
                position = min(max(position, 0.0), cells - 1.0)
            low = math.floor(position)
            for corner, weight in ((low, 1 - (position - low)), (low + 1, position - low)):
                if weight > 0:
                    place = (*cell[:axis], corner % cells, *cell[axis + 1 :])
                    ends[(direction, *cell)] += weight * volume[(slice(None), *place)]
    return ends


def attend_by_loops(attention, volume, ends):
    """The attention of one sample, a voxel at a time, before its norm: (C, X, Y, Z)."""
    channels, *shape = volume.shape
    change = torch.zeros_like(volume)
    for cell in itertools.product(*map(range, shape)):
        own = volume[(slice(None), *cell)]
        query = attention.query.weight @ own + attention.query.bias
        seven = [own, *(ends[(direction, *cell)] for direction in range(6))]
        scores = [float(query @ feature) / math.sqrt(channels) for feature in seven]
        total = sum(math.exp(score) for score in scores)
        mean = sum(math.exp(score) / total * feature for score, feature in zip(scores, seven, strict=True))
        change[(slice(None), *cell)] = attention.value.weight @ mean
    return change


@torch.no_grad()
@GRIDS
def test_ends_equal_loops_over_voxels_and_directions(geometry):
    volume = torch.randn(2, 3, *geometry.shape, dtype=torch.float64)
    lengths = torch.rand(2, 6, *geometry.shape, dtype=torch.float64)
    lengths[0, :, 0], lengths[1, :, 1] = 0.0, 1.0
    ends = torch.stack(end_features(volume, lengths, geometry.periodic), dim=1)
    for sample in range(2):
        expected = ends_by_loops(volume[sample], lengths[sample], geometry.periodic)
        torch.testing.assert_close(ends[sample], expected)


@torch.no_grad()
@GRIDS
def test_attention_equals_loops_over_voxels(geometry):
    attention = EndAttention(8, geometry.periodic).double()
    volume = torch.randn(1, 8, *geometry.shape, dtype=torch.float64)
    lengths = torch.rand(1, 6, *geometry.shape, dtype=torch.float64)
    ends = ends_by_loops(volume[0], lengths[0], geometry.periodic)
    change = attend_by_loops(attention, volume[0], ends)
    change = (change - change.mean()) / (change.var(correction=0) + attention.norm.eps).sqrt()  # one group
    torch.testing.assert_close(attention(volume, lengths)[0], (volume[0] + change).clamp(min=0))


@torch.no_grad()
def test_the_refiner_is_its_parts():
    refiner, volume = make(CYLINDER), torch.randn(2, 4, *CYLINDER.shape, dtype=torch.float64)
    refined, extras = refiner.with_extras(volume, SKETCHED)
    encoded = refiner.encoder(volume, SKETCHED)
    torch.testing.assert_close(extras.run_lengths, refiner.lengths(encoded).sigmoid())
    assert torch.equal(refined, refiner.attention(encoded, extras.run_lengths))
    assert torch.equal(refined, refiner(volume, SKETCHED))
    assert extras.coarse_logits == ()


def test_runs_are_short_before_training():
    lengths = Focus(CUBOID, 4, [8], [1]).with_extras(torch.randn(1, 4, *CUBOID.shape), SKETCHED)[1].run_lengths
    assert 0.02 < lengths.mean() < 0.1


@torch.no_grad()
@pytest.mark.parametrize("roll", [2, 6])
def test_rotating_the_world_rotates_the_volume_and_the_runs(roll):
    refiner, volume = make(CYLINDER), torch.randn(1, 4, *CYLINDER.shape, dtype=torch.float64)
    refined, extras = refiner.with_extras(volume, SKETCHED)
    rolled, their_extras = refiner.with_extras(volume.roll(roll, dims=3), SKETCHED)
    torch.testing.assert_close(rolled, refined.roll(roll, dims=3))
    torch.testing.assert_close(their_extras.run_lengths, extras.run_lengths.roll(roll, dims=3))


def test_gradients_of_ends_are_those_of_differences():
    volume = torch.randn(1, 2, 3, 4, 2, dtype=torch.float64, requires_grad=True)
    lengths = torch.rand(1, 6, 3, 4, 2, dtype=torch.float64, requires_grad=True)
    function = lambda *inputs: torch.stack(end_features(*inputs, (False, True, False)))  # noqa: E731
    assert torch.autograd.gradcheck(function, (volume, lengths), eps=1e-7, atol=1e-4)


@GRIDS
def test_training_reaches_every_parameter(geometry):
    refiner = make(geometry).float()
    refined = refiner(torch.randn(2, 4, *geometry.shape), SKETCHED)
    (refined * torch.randn_like(refined)).sum().backward()
    for name, parameter in refiner.named_parameters():
        assert parameter.grad.abs().sum() > 0, name
