import math

import pytest
import torch
from torch.nn import functional as F

from omniocc.geometry import Cuboid, Cylinder
from omniocc.geometry.directions import rays_around
from omniocc.loss import CrossEntropy, SeenFirst
from omniocc.loss.first_hit import RayCells
from omniocc.loss.seen_first import seen_cells

LINE = RayCells(torch.tensor([[0, 1, 2, 4]]), torch.tensor([[0.0, 1.0, 2.0, math.inf]]))  # three of four cells
CYLINDER = Cylinder((8, 12, 4), (0.0, 16.0), (-2.0, 2.0))


def term(hidden_weight, grid=CYLINDER):
    return SeenFirst(2.0, 5, grid, 24, hidden_weight)


@pytest.mark.parametrize(
    ("target", "seen"),
    [
        ([0, 2, 0, 1], [True, True, False, False]),
        ([0, 255, 1, 0], [True, True, False, False]),
        ([0, 0, 0, 3], [True, True, True, False]),
        ([3, 0, 0, 0], [True, False, False, False]),
    ],
)
def test_cells_up_to_the_first_hit_are_seen(target, seen):
    assert seen_cells(torch.tensor([target], dtype=torch.uint8), LINE).tolist() == [seen]


@pytest.mark.parametrize("grid", [CYLINDER, Cuboid((8, 8, 4), (-8.0, 8.0), (-8.0, 8.0), (-2.0, 2.0))])
def test_seen_cells_are_those_in_which_steps_along_the_rays_lie(grid):
    torch.manual_seed(0)
    target = (torch.rand(1, *grid.shape) < 0.1).byte()
    loss = term(0.0, grid)
    seen = seen_cells(target.flatten(1), RayCells(loss.cells, loss.entry_m))[0]
    expected = torch.zeros(grid.num_cells, dtype=torch.bool)
    steps_m = torch.arange(0.0005, 24.0, 0.004, dtype=torch.float64)[:, None]
    strides = torch.tensor([grid.shape[1] * grid.shape[2], grid.shape[2], 1])
    for direction in rays_around(24).double():
        index, inside = grid.index(steps_m * direction)
        cells = (index * strides).sum(-1)[inside]
        stops = target.flatten()[cells].nonzero()
        end = int(stops[0]) + 1 if len(stops) else len(cells)
        expected[cells[:end]] = True
    assert not (expected & ~seen).any()
    assert int((seen & ~expected).sum()) <= 2  # corners that a ray crosses within less than a step


def test_without_a_weight_for_hidden_cells_only_seen_ones_count():
    torch.manual_seed(1)
    target = (torch.rand(2, *CYLINDER.shape) < 0.1).byte() * torch.randint(1, 5, (2, *CYLINDER.shape)).byte()
    logits, counts = torch.randn(2, 5, *CYLINDER.shape), torch.tensor([1000, 10, 20, 30, 40])
    loss = term(0.0)
    loss.set_class_counts(counts)
    seen = seen_cells(target.flatten(1), RayCells(loss.cells, loss.entry_m)).view_as(target)
    assert 0 < seen.float().mean() < 1
    weights = 1 / torch.log(counts.double() / counts.sum() + 2)
    expected = F.cross_entropy(logits.movedim(1, -1)[seen].double(), target[seen].long(), weights)
    torch.testing.assert_close(loss(logits, target).double(), expected, rtol=1e-5, atol=0)


def test_with_weight_one_it_is_the_plain_cross_entropy():
    torch.manual_seed(2)
    target = torch.randint(0, 5, (2, *CYLINDER.shape)).byte()
    target[0, 0] = 255
    logits = torch.randn(2, 5, *CYLINDER.shape)
    torch.testing.assert_close(term(1.0)(logits, target), CrossEntropy(2.0, 5)(logits, target))


def test_without_known_voxels_it_is_zero():
    target = torch.full((1, *CYLINDER.shape), 255, dtype=torch.uint8)
    assert term(0.5)(torch.randn(1, 5, *CYLINDER.shape), target) == 0


@pytest.mark.parametrize("values", [(0, 0.5), (10, -0.1), (10, 1.5)])
def test_impossible_arguments_are_refused(values):
    with pytest.raises(ValueError, match=r"azimuths is .*hidden_weight is"):
        SeenFirst(2.0, 5, CYLINDER, *values)


def test_hidden_cells_count_by_their_weight():
    """Of four cells the first two are seen; the hidden two are right, the seen ones have equal logits."""
    line = Cuboid((4, 1, 1), (-1.0, 7.0), (-1.0, 1.0), (-1.0, 1.0))
    loss = SeenFirst(2.0, 3, line, 1, 0.5)
    loss.cells, loss.entry_m = torch.tensor([[0, 1, 2, 4]]), torch.tensor([[0.0, 1.0, 2.0, math.inf]])
    target = torch.tensor([0, 2, 0, 1], dtype=torch.uint8).view(1, 4, 1, 1)
    logits = torch.zeros(1, 3, 4, 1, 1)
    logits[0, 1, 3] = logits[0, 0, 2] = 60.0
    assert loss(logits, target).item() == pytest.approx(2 * math.log(3) / (2 + 2 * 0.5), rel=1e-5)
