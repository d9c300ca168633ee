import itertools

import pytest
import torch

from omniocc.extras.rivals import RunLengths
from omniocc.extras.rivals.run_lengths import six_runs
from omniocc.geometry import Cuboid, Cylinder

GRIDS = [Cylinder((5, 7, 4)), Cuboid((5, 7, 4))]
ON_GRIDS = pytest.mark.parametrize("geometry", GRIDS, ids=["cylinder", "cuboid"])


def run_by_steps(labels, cell, axis, sign, wraps):
    """Walk from a cell: how many cells with its label follow, and whether the run and its end are known."""
    cells, place, length = labels.shape[axis], list(cell), 0
    own = int(labels[cell])
    while length < cells - 1:
        place[axis] += sign
        if not 0 <= place[axis] < cells:
            if not wraps:
                return length, own != 255
            place[axis] %= cells
        label = int(labels[tuple(place)])
        if label != own:
            return length, 255 not in (own, label)
        length += 1
    return length, own != 255


def labels_in_runs(geometry, seed):
    generator = torch.Generator().manual_seed(seed)
    labels = torch.randint(0, 3, (3, *geometry.shape), generator=generator, dtype=torch.uint8)
    labels[0, :, :, 0] = 2  # a whole layer, also around the ring
    labels[1] = labels[1, :1, :1]  # long runs
    labels[2][torch.rand(geometry.shape, generator=generator) < 0.15] = 255
    return labels


def loss_by_loops(geometry, lengths, labels, zero_weight, other_weight):
    total, count = 0.0, 0
    for sample, cell in itertools.product(range(len(labels)), itertools.product(*map(range, geometry.shape))):
        for direction in range(6):
            axis, sign = direction // 2, 1 - 2 * (direction % 2)
            length, known = run_by_steps(labels[sample], cell, axis, sign, geometry.periodic[axis])
            if known:
                error = abs(float(lengths[(sample, direction, *cell)]) - length / geometry.shape[axis])
                smooth = error**2 / 2 if error < 1 else error - 0.5
                total += smooth * (zero_weight if length == 0 else other_weight)
                count += 1
    return total / count


@ON_GRIDS
def test_run_lengths_equal_steps_from_cell_to_cell(geometry):
    labels = labels_in_runs(geometry, 0)
    fractions, known = six_runs(labels, geometry.periodic)
    for sample, cell in itertools.product(range(3), itertools.product(*map(range, geometry.shape))):
        for direction in range(6):
            axis, sign = direction // 2, 1 - 2 * (direction % 2)
            length, there = run_by_steps(labels[sample], cell, axis, sign, geometry.periodic[axis])
            place = (sample, direction, *cell)
            assert bool(known[place]) == there, place
            if there:
                assert float(fractions[place]) * geometry.shape[axis] == pytest.approx(length, abs=1e-5), place


@ON_GRIDS
def test_loss_equals_loops(geometry):
    torch.manual_seed(0)
    labels = labels_in_runs(geometry, 1)
    lengths = torch.rand(3, 6, *geometry.shape)
    expected = loss_by_loops(geometry, lengths, labels, 10.0, 1000.0)
    assert RunLengths(geometry, 10.0, 1000.0)(lengths, labels).item() == pytest.approx(expected, rel=1e-5)


def test_runs_wrap_around_on_a_ring_alone():
    labels = torch.zeros(1, 3, 8, 3, dtype=torch.uint8)
    labels[:, :, 3:6] = 1
    ring, _ = six_runs(labels, (False, True, False))
    line, _ = six_runs(labels, (False, False, False))
    assert (ring[0, 2, 0, :, 0] * 8).tolist() == [2, 1, 0, 2, 1, 0, 4, 3]
    assert (line[0, 2, 0, :, 0] * 8).tolist() == [2, 1, 0, 2, 1, 0, 1, 0]
    assert (ring[0, 3, 0, :, 0] * 8).tolist() == [2, 3, 4, 0, 1, 2, 0, 1]
    assert (line[0, 3, 0, :, 0] * 8).tolist() == [0, 1, 2, 0, 1, 2, 0, 1]


def test_true_runs_cost_nothing_and_unknown_ones_neither():
    geometry = GRIDS[0]
    labels = labels_in_runs(geometry, 2)
    true, known = six_runs(labels, geometry.periodic)
    loss = RunLengths(geometry, 10.0, 1000.0)
    assert loss(torch.where(known, true, 0.7), labels) == 0
    assert not known.all()
    lengths = torch.rand(1, 6, *geometry.shape, requires_grad=True)
    value = loss(lengths, torch.full((1, *geometry.shape), 255, dtype=torch.uint8))
    value.backward()
    assert value == 0
    assert lengths.grad.abs().sum() == 0


def test_descent_finds_the_runs():
    geometry = GRIDS[0]
    labels = labels_in_runs(geometry, 3)[:1]
    scores = torch.zeros(1, 6, *geometry.shape, requires_grad=True)
    loss, optimizer = RunLengths(geometry, 10.0, 1000.0), torch.optim.Adam([scores], 0.2)
    values = []
    for _ in range(60):
        optimizer.zero_grad()
        values.append(loss(scores.sigmoid(), labels))
        values[-1].backward()
        optimizer.step()
    assert values[-1] < 0.05 * values[0]


def test_negative_weights_are_named():
    with pytest.raises(ValueError, match=r"-1.*must not be negative"):
        RunLengths(GRIDS[0], -1.0, 1000.0)
