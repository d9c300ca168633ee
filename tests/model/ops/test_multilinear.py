import itertools
import math

import pytest
import torch

from omniocc.model.ops import multilinear
from omniocc.model.ops.multilinear import corners, sum_samples

SHAPE, PERIODIC = (3, 5, 2), (False, True, False)


def sample(volume, position):
    """(C,) at a position in cells, by hand."""
    total = torch.zeros(volume.shape[-1], dtype=volume.dtype)
    for corner in itertools.product((0, 1), repeat=3):
        cell = [math.floor(value) + step for value, step in zip(position.tolist(), corner, strict=True)]
        part = math.prod(1 - (value - at).abs() for value, at in zip(position, cell, strict=True))
        cell[1] %= SHAPE[1]
        if all(0 <= at < size for at, size in zip(cell, SHAPE, strict=True)):
            total = total + part * volume[tuple(cell)]
    return total


def ours(volume, positions, weights):
    wrapped = torch.cat([volume[:, -1:], volume, volume[:, :1]], dim=1)
    table = torch.nn.functional.pad(wrapped, (0, 0, 1, 1, 0, 0, 1, 1)).flatten(0, 2)
    found = corners(positions, weights, SHAPE, PERIODIC)
    return sum_samples(table, found.row, found.weights, found.steps)


def inputs():
    positions = torch.rand(3, 20, 3, dtype=torch.float64) * 14 - 5
    tensors = torch.randn(*SHAPE, 4, dtype=torch.float64), positions, torch.randn(20, 3, dtype=torch.float64)
    return [tensor.requires_grad_() for tensor in tensors]


@pytest.mark.parametrize("sums", [20, 8], ids=["at once", "in three chunks"])
def test_values_and_gradients_are_those_of_loops(assert_same_gradients, monkeypatch, sums):
    monkeypatch.setattr(multilinear, "CHUNK_SUMS", sums)
    volume, positions, weights = tensors = inputs()
    expected = torch.stack(
        [sum(weights[n, k] * sample(volume, positions[:, n, k]) for k in range(3)) for n in range(20)]
    )
    result = ours(*tensors)
    assert_same_gradients(result, expected, tensors)


def test_a_position_just_below_the_seam_reads_the_cell_at_the_seam():
    volume = torch.arange(30.0).view(*SHAPE, 1)
    positions = torch.tensor([1.0, -1e-9, 0.0]).view(3, 1, 1)  # float32 rounds it up to a whole turn
    assert ours(volume, positions, torch.ones(1, 1)).item() == volume[1, 0, 0].item()


def test_far_positions_read_zero_without_gradient_and_nan_stays_nan():
    volume, positions, weights = inputs()
    far = positions.detach().clone()
    far[0, :10] = 1e9
    far[2, 10, 0] = float("nan")
    far.requires_grad_()
    result = ours(volume, far, weights)
    assert result[:10].abs().max() == 0
    assert result[10].isnan().all()
    result[:10].sum().backward()
    assert far.grad[:, :10].abs().max() == 0
