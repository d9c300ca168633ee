import itertools
import math

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.temporal import Recurrent
from omniocc.model.temporal.recurrent import TemporalAttention

CYLINDER, CUBOID = Cylinder((4, 6, 3), (0.0, 8.0)), Cuboid((4, 5, 3), (-8.0, 8.0), (-10.0, 10.0))
GRIDS = pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])
ALL = torch.ones(2, 3, dtype=torch.bool)


def make(geometry, frames=3, layers=2, history_gradient=False):
    temporal = Recurrent(geometry, 4, 8, layers, 2, 3, 12, frames, history_gradient).double()
    for layer in temporal.layers:  # away from the special values at which training begins
        torch.nn.init.normal_(layer.attention.offsets.weight, std=0.2)
        torch.nn.init.normal_(layer.attention.attention.weight, std=0.2)
    return temporal


def make_volumes(geometry, frames=3, batch=2):
    return [torch.randn(batch, 4, *geometry.shape, dtype=torch.float64) for _ in range(frames)]


def moving(frames, step_m=0.0, batch=2):
    poses = torch.eye(4, dtype=torch.float64).repeat(batch, frames, 1, 1)
    poses[:, :, 0, 3] = torch.arange(frames) * step_m
    return poses


def bilinear(values, x, y, periodic):
    """(X, Y, C) at a place in cells, by hand."""
    total = torch.zeros(values.shape[-1], dtype=values.dtype)
    for i, j in itertools.product((math.floor(x), math.floor(x) + 1), (math.floor(y), math.floor(y) + 1)):
        part = (1 - abs(x - i)) * (1 - abs(y - j))
        j = j % values.shape[1] if periodic[1] else j
        if 0 <= i < values.shape[0] and 0 <= j < values.shape[1]:
            total += part * values[i, j]
    return total


def attend_by_loops(attention, before, present, periodic):
    """One sample: every cell, head, view and point on its own."""
    heads, points, channels = attention.heads, attention.points, present.shape[-1] // attention.heads
    result = torch.zeros_like(present)
    for x, y in itertools.product(range(present.shape[0]), range(present.shape[1])):
        query = torch.cat([before[x, y], present[x, y]])
        offsets = attention.offsets(query).view(2, heads, 2, points)
        weights = attention.attention(query).view(heads, 2, points).softmax(-1)
        total = torch.zeros_like(present[x, y])
        for head, (view, source), point in itertools.product(range(heads), enumerate((before, present)), range(points)):
            part = slice(head * channels, (head + 1) * channels)
            dx, dy = offsets[:, head, view, point].tolist()
            total[part] += weights[head, view, point] * bilinear(
                attention.value(source)[..., part], x + dx, y + dy, periodic
            )
        result[x, y] = attention.output(total / 2)
    return result


@torch.no_grad()
@GRIDS
def test_attention_equals_loops_over_cells_heads_views_and_points(geometry):
    attention = make(geometry).layers[0].attention
    before, present = torch.randn(2, 2, *geometry.shape[:2], 8, dtype=torch.float64)
    expected = [attend_by_loops(attention, *views, geometry.periodic) for views in zip(before, present, strict=True)]
    torch.testing.assert_close(attention(present, before, geometry.periodic), torch.stack(expected))


@torch.no_grad()
@GRIDS
def test_a_resting_car_hands_each_view_to_the_next_frame(geometry):
    temporal, volumes = make(geometry), make_volumes(geometry)

    def look(volume, before):
        columns = volume.movedim(1, -1).flatten(-2)  # heights, then channels
        present = columns @ temporal.fold.weight.T + temporal.fold.bias
        before = present if before is None else before
        for layer in temporal.layers:
            mixed = layer.attention_norm(present + layer.attention(present, before, geometry.periodic))
            present = layer.feedforward(mixed)
        return present

    view = look(volumes[2], look(volumes[1], look(volumes[0], None)))
    change = view @ temporal.unfold.weight.T + temporal.unfold.bias
    expected = volumes[2] + change.unflatten(-1, (geometry.shape[2], 4)).movedim(-1, 1)
    torch.testing.assert_close(temporal(volumes, moving(3), ALL), expected)


@torch.no_grad()
def test_history_moves_with_the_car():
    """A car that drives one cell ahead finds what was at x + 1 at x; what comes in at the front has no past."""
    temporal, volumes = make(CUBOID, frames=2), make_volumes(CUBOID, 2)
    view = temporal._attend(volumes[0], moving(1)[:, 0], None)
    moved = torch.cat([view[:, 1:], torch.zeros_like(view[:, :1])], dim=1)
    present = volumes[1].movedim(1, -1).flatten(-2) @ temporal.fold.weight.T + temporal.fold.bias
    for layer in temporal.layers:
        present = layer(present, moved, CUBOID.periodic)
    expected = volumes[1] + temporal.unfold(present).unflatten(-1, (3, 4)).movedim(-1, 1)
    torch.testing.assert_close(temporal(volumes, moving(2, step_m=4.0), ALL[:, :2]), expected)


@torch.no_grad()
@GRIDS
def test_frames_that_do_not_exist_change_nothing(geometry):
    temporal, volumes, poses = make(geometry, frames=4), make_volumes(geometry, 4), moving(4, step_m=1.0)
    exists = torch.tensor([[False, True, False, True], [False, False, False, True]])
    fused = temporal(volumes, poses, exists)
    other = [volume.clone() for volume in volumes]
    for sample, frame in (~exists).nonzero().tolist():
        other[frame][sample] = 7.0
        poses[sample, frame, :3, 3] = 99.0
    torch.testing.assert_close(temporal(other, poses, exists), fused)
    first = temporal([volumes[1][:1], volumes[3][:1]], moving(4, 1.0)[:1, [1, 3]], ALL[:1, :2])
    torch.testing.assert_close(fused[:1], first)
    second = temporal([volumes[3][1:]], moving(4, 1.0)[1:, 3:], ALL[1:, :1])
    torch.testing.assert_close(fused[1:], second)


@torch.no_grad()
def test_rotating_the_world_rotates_the_answer():
    temporal, volumes = make(CYLINDER), make_volumes(CYLINDER)
    turned = temporal([volume.roll(2, dims=3) for volume in volumes], moving(3), ALL)
    torch.testing.assert_close(turned, temporal(volumes, moving(3), ALL).roll(2, dims=3))


@pytest.mark.parametrize("history_gradient", [False, True])
def test_history_has_a_gradient_only_with_history_gradient(history_gradient):
    temporal, volumes = make(CUBOID, history_gradient=history_gradient), make_volumes(CUBOID)
    volumes = [volume.requires_grad_() for volume in volumes]
    temporal(volumes, moving(3, 1.0), ALL).square().mul(torch.rand(4, 1, 1, 1)).sum().backward()
    assert (volumes[0].grad is not None) == history_gradient
    assert volumes[2].grad.abs().sum() > 0
    for name, parameter in temporal.named_parameters():
        assert parameter.grad.abs().sum() > 0, name


def test_gradients_of_attention_are_those_of_finite_differences():
    attention = TemporalAttention(4, heads=2, points=2).double()
    torch.nn.init.normal_(attention.offsets.bias)  # between cells, where bilinear samples are smooth
    views = torch.randn(2, 1, 3, 4, 4, dtype=torch.float64, requires_grad=True)
    run = lambda views: attention(views[1], views[0], (False, True, False))  # noqa: E731
    assert torch.autograd.gradcheck(run, views, eps=1e-7, atol=1e-5, fast_mode=True)


def test_bfloat16_keeps_positions_in_single_precision():
    temporal, volumes = make(CYLINDER).float(), [volume.float() for volume in make_volumes(CYLINDER)]
    with torch.autocast("cpu", dtype=torch.bfloat16):
        fused = temporal(volumes, moving(3, 0.5), ALL)
    torch.testing.assert_close(fused.float(), temporal(volumes, moving(3, 0.5), ALL), atol=0.15, rtol=0.1)


def test_the_past_leaves_autocast_the_gradients_of_the_newest_frame():
    temporal, volumes = make(CUBOID).float(), [volume.float() for volume in make_volumes(CUBOID)]
    with torch.autocast("cpu", dtype=torch.bfloat16):
        fused = temporal(volumes, moving(3, 0.5), ALL)
    fused.float().square().mean().backward()
    assert [name for name, parameter in temporal.named_parameters() if parameter.grad is None] == []


def test_a_window_needs_a_past_and_heads_must_divide_channels():
    with pytest.raises(ValueError, match="frames is 1"):
        make(CUBOID, frames=1)
    with pytest.raises(ValueError, match=r"8 channels.* 3 heads"):
        Recurrent(CUBOID, 4, 8, 1, 3, 3, 12, 2, False)
