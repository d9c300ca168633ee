import math

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.loss import FirstHit
from omniocc.loss.first_hit import LEAST, RayCells, first_hits
from omniocc.metric import RayIoU
from rayiou.directions import rays_around

WITHIN_M = (1.0, 2.0, 4.0)
LINE = RayCells(torch.tensor([[0, 1, 2, 4]]), torch.tensor([[0.0, 1.0, 2.0, math.inf]]))  # three of four cells


WEIGHTS = {"likelihood": (1.0, 0.0), "overlap": (0.0, 1.0)}


def logits_of(rows):
    """Return logits (1, C, cells) of the probabilities of each cell's classes."""
    return torch.tensor(rows).log().T[None]


def test_probabilities_of_a_ray_by_hand():
    rows = [[0.5, 0.3, 0.2], [0.4, 0.0 + 1e-9, 0.6], [0.1, 0.2, 0.7], [0.0 + 1e-9, 0.5, 0.5]]
    target = torch.tensor([[0, 2, 1, 1]], dtype=torch.uint8)
    hits = first_hits(logits_of(rows), target, LINE, (0.5, 1.0))
    assert hits.labels.tolist() == [[2]]
    second, third = 0.5 * 0.6, 0.5 * 0.4 * 0.7
    torch.testing.assert_close(hits.correct[:, 0, 0], torch.tensor([second, 0.2 + second + third]))
    torch.testing.assert_close(
        hits.predicted, torch.tensor([[0.5 + 0.2 + 0.02, 0.3 + 0.2 * 0.2, 0.2 + second + third]])
    )


@pytest.mark.parametrize("weights", WEIGHTS.values(), ids=WEIGHTS)
@pytest.mark.parametrize("target", [[0, 0, 0, 1], [0, 255, 1, 1]])
def test_rays_without_a_known_hit_do_not_count(weights, target):
    grid = Cuboid((4, 1, 1), (-1.0, 7.0), (-1.0, 1.0), (-1.0, 1.0))
    term = FirstHit(grid, 1, [1.0], *weights)
    term.cells, term.entry_m = LINE
    logits = torch.randn(1, 3, 4, 1, 1, requires_grad=True)
    value = term(logits, torch.tensor(target, dtype=torch.uint8).view(1, 4, 1, 1))
    value.backward()
    assert value == 0
    assert logits.grad is not None
    assert not logits.grad.any()


@pytest.mark.parametrize(
    "grid",
    [Cylinder((16, 20, 8), (0.0, 16.0), (-2.0, 2.0)), Cuboid((16, 16, 8), (-8.0, 8.0), (-8.0, 8.0), (-2.0, 2.0))],
    ids=["cylinder", "cuboid"],
)
def test_certain_predictions_have_the_scores_of_the_metric(grid):
    torch.manual_seed(0)
    target = (torch.rand(2, *grid.shape) < 0.03).byte() * torch.randint(1, 5, (2, *grid.shape)).byte()
    flipped = torch.rand(2, *grid.shape) < 0.05
    labels = torch.where(flipped, torch.randint(0, 5, (2, *grid.shape)).byte(), target)
    logits = 40 * torch.nn.functional.one_hot(labels.long(), 5).movedim(-1, 1).float()
    metric = RayIoU(grid, num_classes=5, thresholds_m=WITHIN_M, directions=rays_around(60))
    metric.update(labels, target)
    scores = metric.compute()
    soft = 1 - FirstHit(grid, 60, WITHIN_M, 0.0, 1.0)(logits, target)
    assert 0.3 < soft < 0.9
    torch.testing.assert_close(soft.double(), scores["rayiou"].double(), atol=2e-3, rtol=0)


def test_agreement_costs_nothing_and_a_wrong_class_all():
    grid = Cylinder((16, 20, 8), (0.0, 16.0), (-2.0, 2.0))
    target = torch.zeros(1, *grid.shape, dtype=torch.uint8)
    target[0, 10] = 1
    right = torch.nn.functional.one_hot(target.long(), 3).movedim(-1, 1) * 40.0
    wrong = right[:, [0, 2, 1]]
    for kind, worst in (("likelihood", -math.log(LEAST)), ("overlap", 1.0)):
        loss = FirstHit(grid, 20, WITHIN_M, *WEIGHTS[kind])
        assert loss(right, target) == pytest.approx(0, abs=2e-3)
        assert loss(wrong, target) == pytest.approx(worst, abs=1e-3)


@pytest.mark.parametrize("weights", WEIGHTS.values(), ids=WEIGHTS)
def test_descent_finds_the_first_hits(weights):
    grid = Cylinder((8, 12, 4), (0.0, 8.0), (-2.0, 2.0))
    torch.manual_seed(0)
    target = (torch.rand(1, *grid.shape) < 0.1).byte() * 2
    logits = torch.zeros(1, 3, *grid.shape, requires_grad=True)
    term, optimizer = FirstHit(grid, 12, [1.0], *weights), torch.optim.Adam([logits], 0.3)
    first = None
    for _ in range(60):
        optimizer.zero_grad()
        value = term(logits, target)
        first = first or value.item()
        value.backward()
        optimizer.step()
    assert value < 0.2 * first


def test_both_parts_add_up():
    grid = Cylinder((8, 12, 4), (0.0, 8.0), (-2.0, 2.0))
    target, logits = (torch.rand(2, *grid.shape) < 0.2).byte() * 2, torch.randn(2, 3, *grid.shape)
    parts = [FirstHit(grid, 12, [1.0], *weights)(logits, target) for weights in WEIGHTS.values()]
    assert FirstHit(grid, 12, [1.0], 2.0, 0.5)(logits, target) == pytest.approx(2 * parts[0] + 0.5 * parts[1])


@pytest.mark.parametrize(("azimuths", "within_m"), [(0, [1.0]), (4, []), (4, [1.0, 0.0])])
def test_impossible_values_are_named(azimuths, within_m):
    with pytest.raises(ValueError, match=r"azimuths is .*within_m"):
        FirstHit(Cylinder((8, 12, 4), (0.0, 8.0), (-2.0, 2.0)), azimuths, within_m, 1.0, 1.0)
