import itertools
import math

import pytest
import torch

from omniocc.extras.rivals import Experts
from omniocc.extras.rivals.experts import ExpertBlock, gradient_energy
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.sketch import Sketched

SKETCHED = Sketched(torch.ones(1, 1, 1, 1, dtype=torch.bool))
CYLINDER, CUBOID = Cylinder((4, 8, 3)), Cuboid((5, 6, 3))
GRIDS = pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])


def make(geometry, channels=(8, 8, 16)):
    return Experts(geometry, 4, list(channels), experts=3, num_classes=5).double()


def at(volume, cell, periodic):
    """The feature of a cell of one sample; zeros beyond ends that do not wrap around."""
    shape = volume.shape[1:]
    place = [k % size if wraps else k for k, size, wraps in zip(cell, shape, periodic, strict=True)]
    inside = all(0 <= k < size for k, size in zip(place, shape, strict=True))
    return volume[(slice(None), *place)] if inside else torch.zeros(len(volume), dtype=volume.dtype)


def moved(cell, axis, by):
    return tuple(k + by * (other == axis) for other, k in enumerate(cell))


def energy_by_hand(volume, cell, periodic):
    """log(1 + mean squared central difference) along each axis."""
    energies = []
    for axis in range(3):
        difference = (at(volume, moved(cell, axis, 1), periodic) - at(volume, moved(cell, axis, -1), periodic)) / 2
        energies.append(math.log(1 + float((difference**2).mean())))
    return torch.tensor(energies, dtype=torch.float64)


def linear(layer, row):
    return layer.weight @ row + layer.bias


def block_by_loops(block, volume, periodic):
    """One block on one sample, a voxel at a time."""
    channels, *shape = volume.shape
    cells = list(itertools.product(*map(range, shape)))
    spread = torch.zeros_like(volume)
    for cell, step in itertools.product(cells, itertools.product((-1, 0, 1), repeat=3)):
        neighbour = at(volume, tuple(k + s for k, s in zip(cell, step, strict=True)), periodic)
        kernel = block.depthwise.weight[(slice(None), 0, *(s + 1 for s in step))]
        spread[(slice(None), *cell)] += kernel * neighbour
    first, _, second = block.channel_gate
    mean = sum(spread[(slice(None), *cell)] for cell in cells) / len(cells)
    hidden = linear(first, mean)
    channel_gate = 1 / (1 + (-linear(second, hidden / (1 + (-hidden).exp()))).exp())
    mixed = torch.zeros_like(volume)
    for cell in cells:
        row = spread[(slice(None), *cell)] * channel_gate
        place = linear(block.place_gate, torch.stack([row.mean(), row.max()]))
        row = row / (1 + (-place).exp())
        scores = linear(block.choice, energy_by_hand(volume, cell, periodic)).exp()
        for expert, weight in enumerate(scores / scores.sum()):
            rows = slice(expert * channels, (expert + 1) * channels)
            mixed[(slice(None), *cell)] += weight * (block.experts.weight[rows] @ row + block.experts.bias[rows])
    assert block.norm.num_groups == 1
    unit = (mixed - mixed.mean()) / (mixed.var(correction=0) + block.norm.eps).sqrt()
    return volume + unit.clamp(min=0)


@torch.no_grad()
@GRIDS
def test_a_block_equals_loops_over_voxels_and_experts(geometry):
    block = ExpertBlock(8, geometry.periodic, 3).double()
    torch.nn.init.normal_(block.choice.weight, std=2.0)
    volume = torch.randn(2, 8, *geometry.shape, dtype=torch.float64)
    result = block(volume)
    for sample in range(2):
        torch.testing.assert_close(result[sample], block_by_loops(block, volume[sample], geometry.periodic))


@torch.no_grad()
@GRIDS
def test_gradient_energy_equals_differences_by_hand(geometry):
    volume = torch.randn(1, 3, *geometry.shape, dtype=torch.float64)
    energy = gradient_energy(volume, geometry.periodic)[0]
    for cell in itertools.product(*map(range, geometry.shape)):
        torch.testing.assert_close(energy[(slice(None), *cell)], energy_by_hand(volume[0], cell, geometry.periodic))


@torch.no_grad()
@GRIDS
def test_coarser_levels_are_classified(geometry):
    refiner, volume = make(geometry), torch.randn(2, 4, *geometry.shape, dtype=torch.float64)
    refined, extras = refiner.with_extras(volume, SKETCHED)
    assert torch.equal(refined, refiner(volume, SKETCHED))
    *coarse, fine = refiner.levels(volume)
    assert torch.equal(fine, refined)
    assert [entry.block for entry in extras.coarse_logits] == [4, 2]
    for entry, level, classify in zip(extras.coarse_logits, coarse, refiner.classifiers, strict=True):
        assert entry.logits.shape == (2, 5, *(-(-size // entry.block) for size in geometry.shape))
        expected = torch.einsum("kc,bcxyz->bkxyz", classify.weight, level) + classify.bias[:, None, None, None]
        torch.testing.assert_close(entry.logits, expected)
    assert extras.run_lengths is None


@torch.no_grad()
@pytest.mark.parametrize("roll", [4])
def test_rotating_the_world_rotates_the_answer(roll):
    refiner, volume = make(CYLINDER), torch.randn(1, 4, *CYLINDER.shape, dtype=torch.float64)
    rolled = refiner(volume.roll(roll, dims=3), SKETCHED)
    torch.testing.assert_close(rolled, refiner(volume, SKETCHED).roll(roll, dims=3))


@pytest.mark.parametrize("geometry", [Cylinder((8, 12, 4)), Cuboid((9, 8, 5))], ids=["cylinder", "cuboid"])
def test_training_reaches_every_parameter(geometry):
    refiner = make(geometry).float()
    refined, extras = refiner.with_extras(torch.randn(2, 4, *geometry.shape), SKETCHED)
    outputs = (refined, *(entry.logits for entry in extras.coarse_logits))
    sum((output * torch.randn_like(output)).sum() for output in outputs).backward()
    for name, parameter in refiner.named_parameters():
        assert parameter.grad.abs().sum() > 0, name


def test_sizes_that_do_not_fit_are_named():
    with pytest.raises(ValueError, match="experts is 0"):
        Experts(CUBOID, 4, [8], 0, 5)
    with pytest.raises(ValueError, match=r"multiples of 4.* 6"):
        make(Cylinder((4, 6, 2)))
