import itertools
import math

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.lifter import Coloring
from omniocc.model.refiner import Attention, attention
from omniocc.model.refiner.attention import sheet, sphere_offsets
from omniocc.model.sketch import Sketched

SKETCHED = Sketched(torch.ones(1, 1, 1, 1, dtype=torch.bool))

CYLINDER, CUBOID = Cylinder((4, 6, 3)), Cuboid((4, 5, 3))


def make(geometry, layers=2, flat=False):
    refiner = Attention(geometry, 8, layers, heads=2, points=3, feedforward_channels=12, flat=flat).double()
    for layer in refiner.layers:  # away from the special values at which training begins
        torch.nn.init.normal_(layer.attention.offsets.weight, std=0.3)
        torch.nn.init.normal_(layer.attention.attention.weight, std=0.3)
    return refiner


def sample(values, position, periodic):
    """(C,) of (*cells, C) at a position in cells, by hand."""
    total = torch.zeros(values.shape[-1], dtype=values.dtype)
    for corner in itertools.product((0, 1), repeat=len(position)):
        cell = [math.floor(place) + step for place, step in zip(position, corner, strict=True)]
        part = math.prod(1 - abs(place - at) for place, at in zip(position, cell, strict=True))
        cell = [at % size if wraps else at for at, size, wraps in zip(cell, values.shape, periodic, strict=False)]
        if all(0 <= at < size for at, size in zip(cell, values.shape, strict=False)):
            total += part * values[tuple(cell)]
    return total


def attend(layer, voxels, cell, periodic):
    """One voxel: the weighted samples of every head and point."""
    heads, points = layer.heads, layer.points
    offsets = layer.offsets(voxels[cell]).view(len(cell), heads, points)
    weights = layer.attention(voxels[cell]).view(heads, points).softmax(1)
    values = layer.value(voxels)
    total = torch.zeros(8, dtype=torch.float64)
    for head, point in itertools.product(range(heads), range(points)):
        part = slice(head * 4, head * 4 + 4)
        position = [at + shift for at, shift in zip(cell, offsets[:, head, point].tolist(), strict=True)]
        total[part] += weights[head, point] * sample(values[..., part], position, periodic)
    return layer.output(total)


def refine_by_loops(refiner, volume):
    """One sample, a voxel at a time."""
    shape, periodic = refiner.layout
    voxels = volume.movedim(0, -1).reshape(*shape, -1) + sum(refiner.places)
    for layer in refiner.layers:
        refined = voxels.clone()
        for cell in itertools.product(*map(range, shape)):
            mixed = attend(layer.attention, voxels, cell, periodic)
            refined[cell] = layer.attention_norm(voxels[cell] + mixed)
        voxels = layer.feedforward(refined)
    return voxels.movedim(-1, 0).reshape(volume.shape)


@torch.no_grad()
@pytest.mark.parametrize("flat", [False, True], ids=["volume", "flat"])
@pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])
def test_equals_loops_over_voxels_heads_points_and_corners(geometry, flat):
    refiner, volume = make(geometry, flat=flat), torch.randn(2, 8, *geometry.shape, dtype=torch.float64)
    expected = torch.stack([refine_by_loops(refiner, sample) for sample in volume])
    torch.testing.assert_close(refiner(volume, SKETCHED), expected)


@pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])
def test_chunks_change_neither_values_nor_gradients(monkeypatch, geometry):
    refiner = make(geometry)
    volume = torch.randn(2, 8, *geometry.shape, dtype=torch.float64, requires_grad=True)
    tensors = [volume, *refiner.parameters()]
    whole = refiner(volume, SKETCHED)
    expected = torch.autograd.grad(whole.square().sum(), tensors)
    monkeypatch.setattr(attention, "CHUNK_SAMPLES", 50 * 6)
    chunked = Attention(geometry, 8, 2, heads=2, points=3, feedforward_channels=12).double()
    chunked.load_state_dict(refiner.state_dict())
    assert chunked.chunk == 50
    parts = chunked(volume, SKETCHED)
    torch.testing.assert_close(parts, whole)
    gradients = torch.autograd.grad(parts.square().sum(), [volume, *chunked.parameters()])
    for gradient, reference in zip(gradients, expected, strict=True):
        torch.testing.assert_close(gradient, reference)


def test_gradients_are_those_of_finite_differences():
    geometry = Cylinder((2, 3, 2))
    refiner = make(geometry, layers=1)
    torch.nn.init.normal_(refiner.layers[0].attention.offsets.bias)  # between cells, where trilinear samples are smooth
    volume = torch.randn(1, 8, *geometry.shape, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda own: refiner(own, SKETCHED), volume, eps=1e-7, atol=1e-5, fast_mode=True)


@torch.no_grad()
@pytest.mark.parametrize("roll", [1, 2, 5])
def test_rotating_the_world_rotates_the_answer(roll):
    refiner, volume = make(CYLINDER), torch.randn(2, 8, *CYLINDER.shape, dtype=torch.float64)
    torch.testing.assert_close(
        refiner(volume.roll(roll, dims=3), SKETCHED), refiner(volume, SKETCHED).roll(roll, dims=3)
    )


@pytest.mark.parametrize(("cells", "shape"), [(128 * 128 * 16, (512, 512)), (128 * 128 * 8, (256, 512)), (7, (1, 7))])
def test_flat_voxels_form_a_picture_as_nearly_square_as_can_be(cells, shape):
    assert sheet(cells) == (shape, (False, False))


@pytest.mark.parametrize("flat", [False, True], ids=["volume", "flat"])
def test_training_reaches_every_parameter_from_its_first_step(flat):
    refiner = Attention(CUBOID, 8, 2, heads=2, points=3, feedforward_channels=12, flat=flat)
    refiner(torch.randn(1, 8, *CUBOID.shape), SKETCHED).square().mul(torch.rand(8, *CUBOID.shape)).sum().backward()
    for name, parameter in refiner.named_parameters():
        assert parameter.grad.abs().sum() > 0, name


def test_voxels_that_were_no_candidates_bring_a_learned_token(fisheye):
    lifter = Coloring(CYLINDER, 8, [4], layers=1, heads=2, points=3, feedforward_channels=8)
    refiner = Attention(CYLINDER, 8, 2, heads=2, points=3, feedforward_channels=8)
    candidates = torch.zeros(1, *CYLINDER.shape, dtype=torch.bool)
    candidates[0, :, 0] = True
    features = [torch.randn(1, 6, 8, 9, 16)]
    refined = refiner(lifter(features, Sketched(candidates), (fisheye,)), SKETCHED)
    refined[0, 0, :, 0].square().sum().backward()  # voxels that were candidates
    assert lifter.empty.grad.abs().sum() > 0
    with torch.no_grad():
        lifter.empty += 1
        assert (
            refiner(lifter(features, Sketched(candidates), (fisheye,)), SKETCHED)[0, :, :, 0] != refined[0, :, :, 0]
        ).any()


def test_heads_start_in_different_directions_and_points_a_cell_apart():
    offsets = sphere_offsets(8, 4)
    assert offsets.abs().amax(0).tolist() == pytest.approx(torch.arange(1.0, 5).expand(8, 4))
    distances = torch.cdist(offsets[..., 0].T, offsets[..., 0].T) + 9 * torch.eye(8)
    assert distances.min() > 0.7
    assert offsets[..., 0].sum(1).abs().max() < 1.5


def test_bfloat16_keeps_positions_in_single_precision():
    refiner, volume = make(CYLINDER).float(), torch.randn(1, 8, *CYLINDER.shape)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        refined = refiner(volume, SKETCHED)
    torch.testing.assert_close(refined.float(), refiner(volume, SKETCHED), atol=0.1, rtol=0.1)


def halfway(coarse, cell, periodic):
    """(C,) of (C, x, y, z) by trilinear interpolation at the centre of a cell of half the size, borders held."""
    total = 0
    for corner in itertools.product((0, 1), repeat=3):
        at, part = [], 1.0
        for fine, step, size, wraps in zip(cell, corner, coarse.shape[1:], periodic, strict=True):
            near, far = fine // 2, fine // 2 + (1 if fine % 2 else -1)
            index = far if step else near
            at.append(index % size if wraps else min(max(index, 0), size - 1))
            part *= 0.25 if step else 0.75
        total = total + part * coarse[(slice(None), *at)]
    return total


@torch.no_grad()
@pytest.mark.parametrize("geometry", [Cylinder((4, 8, 4)), Cuboid((4, 6, 2))], ids=["cylinder", "cuboid"])
def test_halved_attends_among_means_of_eight_voxels_and_interpolates(geometry):
    half = Cylinder((2, 4, 2)) if isinstance(geometry, Cylinder) else Cuboid((2, 3, 1))
    refiner = Attention(geometry, 8, 1, heads=2, points=3, feedforward_channels=12, halved=True).double()
    coarse = Attention(half, 8, 1, heads=2, points=3, feedforward_channels=12).double()
    coarse.load_state_dict(refiner.state_dict())
    volume = torch.randn(1, 8, *geometry.shape, dtype=torch.float64)
    means = sum(volume[:, :, x::2, y::2, z::2] for x, y, z in itertools.product((0, 1), repeat=3)) / 8
    refined, expected = refiner(volume, SKETCHED)[0], coarse(means, SKETCHED)[0]
    for cell in itertools.product(*map(range, geometry.shape)):
        torch.testing.assert_close(refined[(slice(None), *cell)], halfway(expected, cell, geometry.periodic))


def test_only_grids_of_even_size_can_be_halved():
    with pytest.raises(ValueError, match=r"4x6x3.*blocks.*2x2x2"):
        Attention(CYLINDER, 8, 1, heads=2, points=1, feedforward_channels=8, halved=True)


def test_heads_must_divide_channels():
    with pytest.raises(ValueError, match=r"8 channels.* 3 heads"):
        Attention(CYLINDER, 8, 1, heads=3, points=1, feedforward_channels=8)
