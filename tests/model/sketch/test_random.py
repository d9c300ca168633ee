import pytest
import torch

from omniocc.geometry import Cylinder
from omniocc.model.sketch import Random

GRID = Cylinder((8, 12, 4))


def cells(sketch, batch=1):
    return sketch(torch.zeros(batch, 6, 3, 4, 4), ()).candidates


@pytest.mark.parametrize(("fraction", "count"), [(0.25, 96), (0.1, 38), (1.0, 384)])
def test_fraction_of_candidates_is_exact(fraction, count):
    assert cells(Random(GRID, fraction)).sum() == count


def test_same_seed_same_cells_whatever_happened_before():
    first = cells(Random(GRID, 0.25, seed=3))
    torch.rand(5)
    second = Random(GRID, 0.25, seed=3)
    assert torch.equal(first, cells(second))
    assert torch.equal(first, cells(second.eval()))
    assert not torch.equal(first, cells(Random(GRID, 0.25, seed=4)))


def test_cells_are_the_same_in_every_process():
    chosen = cells(Random(GRID, 0.25, seed=0)).flatten().nonzero().flatten()
    # Random(Cylinder((8, 12, 4)), 0.25, seed=0), torch 2.13 on x86
    assert chosen[:8].tolist() == [1, 4, 5, 18, 24, 27, 36, 39]


def test_all_samples_share_the_cells():
    batch = cells(Random(GRID), batch=3)
    assert torch.equal(batch[0], batch[2])


@pytest.mark.parametrize("fraction", [0.0, -0.1, 1.5])
def test_impossible_fractions_are_named(fraction):
    with pytest.raises(ValueError, match=f"fraction is {fraction}"):
        Random(GRID, fraction)
