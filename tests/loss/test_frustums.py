import itertools
import math

import pytest
import torch

from omniocc.extras.rivals import Frustums
from omniocc.extras.rivals.frustums import frustum_of_cells
from omniocc.geometry import Cuboid, Cylinder

GRIDS = [Cylinder((4, 9, 3)), Cuboid((5, 6, 3))]
ON_GRIDS = pytest.mark.parametrize("geometry", GRIDS, ids=["cylinder", "cuboid"])


def frustum_by_hand(point, azimuths, elevations):
    x, y, z = point.tolist()
    column = min(int((math.atan2(y, x) + math.pi) / (2 * math.pi) * azimuths), azimuths - 1)
    elevation_deg = min(max(math.degrees(math.atan2(z, math.hypot(x, y))), -45.0), 45.0 - 1e-9)
    return int((elevation_deg + 45.0) / 90.0 * elevations) * azimuths + column


def loss_by_loops(geometry, logits, target, azimuths, elevations):
    """Mean over samples and frustums with known cells of sum p log(p / q), a cell at a time."""
    classes, terms = logits.shape[1], []
    centers = geometry.centers(torch.float64)
    for sample in range(len(logits)):
        true = torch.zeros(azimuths * elevations, classes, dtype=torch.float64)
        guessed = torch.zeros_like(true)
        for cell in itertools.product(*map(range, geometry.shape)):
            label = int(target[(sample, *cell)])
            if label != 255:
                frustum = frustum_by_hand(centers[cell], azimuths, elevations)
                true[frustum, label] += 1
                scores = logits[(sample, slice(None), *cell)].double().exp()
                guessed[frustum] += scores / scores.sum()
        for counts, guess in zip(true, guessed, strict=True):
            if counts.sum() > 0:
                shares = zip((counts / counts.sum()).tolist(), (guess / counts.sum()).tolist(), strict=True)
                terms.append(sum(p * math.log(p / q) for p, q in shares if p > 0))
    return sum(terms) / len(terms)


def labels_of(geometry):
    target = torch.randint(0, 4, (2, *geometry.shape), dtype=torch.uint8)
    target[torch.rand(target.shape) < 0.2] = 255
    target[1, :2] = 255
    return target


@ON_GRIDS
def test_equals_loops_over_cells_and_frustums(geometry):
    torch.manual_seed(0)
    target, logits = labels_of(geometry), torch.randn(2, 4, *geometry.shape)
    expected = loss_by_loops(geometry, logits, target, 5, 3)
    assert Frustums(geometry, 5, 3)(logits, target).item() == pytest.approx(expected, rel=1e-5)


@ON_GRIDS
def test_all_frustums_are_of_cells(geometry):
    found = frustum_of_cells(geometry, 5, 3)
    points = geometry.centers(torch.float64).reshape(-1, 3)
    assert found.tolist() == [frustum_by_hand(point, 5, 3) for point in points]
    assert len(found.unique()) > 5


@ON_GRIDS
def test_right_shares_cost_nothing_wherever_they_are(geometry):
    torch.manual_seed(0)
    frustum = frustum_of_cells(geometry, 4, 1).view(1, *geometry.shape)
    target = torch.zeros(1, *geometry.shape, dtype=torch.uint8)
    first = (frustum == 0).nonzero()
    target[tuple(first[0])] = 2
    moved = torch.zeros_like(target)
    moved[tuple(first[-1])] = 2
    logits = 60 * torch.nn.functional.one_hot(moved.long(), 3).movedim(-1, 1).float()
    assert Frustums(geometry, 4, 1)(logits, target) == pytest.approx(0, abs=1e-5)


def test_certain_errors_and_unknown_frames_stay_finite():
    geometry = GRIDS[0]
    logits = torch.full((1, 3, *geometry.shape), -200.0)
    logits[:, 1] = 200.0
    logits.requires_grad_()
    for target in (torch.zeros(1, *geometry.shape), torch.full((1, *geometry.shape), 255)):
        logits.grad = None
        value = Frustums(geometry, 4, 2)(logits, target.to(torch.uint8))
        value.backward()
        assert torch.isfinite(value)
        assert torch.isfinite(logits.grad).all()
    assert value == 0


def test_descent_finds_the_shares():
    torch.manual_seed(0)
    geometry = GRIDS[1]
    target, logits = labels_of(geometry), torch.zeros(2, 4, *geometry.shape, requires_grad=True)
    loss, optimizer, values = Frustums(geometry, 5, 2), torch.optim.Adam([logits], 0.1), []
    for _ in range(40):
        optimizer.zero_grad()
        values.append(loss(logits, target))
        values[-1].backward()
        optimizer.step()
    assert values[-1] < 0.02 * values[0]


def test_impossible_numbers_are_named():
    with pytest.raises(ValueError, match=r"azimuths is 4, elevations 0"):
        Frustums(GRIDS[0], 4, 0)


@pytest.mark.parametrize(
    ("cells", "height_m", "expected"),
    [(6, 12.0, [0, 0, 1, 1, 2, 2]), (2, 6.5, [0, 2])],
    ids=["-45 -31 -11 11 31 45 degrees", "-18 and 18 degrees"],
)
def test_cells_are_in_the_row_of_their_elevation(cells, height_m, expected):
    """Cells 10 m ahead, and three rows: below -15 degrees, up to 15 degrees, above."""
    grid = Cuboid((1, 1, cells), (9.0, 11.0), (-1.0, 1.0), (-height_m, height_m))
    assert frustum_of_cells(grid, 1, 3).tolist() == expected
