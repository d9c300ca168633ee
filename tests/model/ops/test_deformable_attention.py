import pytest
import torch
from torch.nn import functional as F

from omniocc.model.ops import deformable_attention
from omniocc.model.ops.deformable_attention import deformable_sum, make_level, make_table
from omniocc.model.ops.visible import Pairs

SAMPLES, CAMERAS, HEADS, CHANNELS, POINTS = 2, 3, 2, 4, 3
SIZES = [(5, 7), (3, 4)]


def make_pairs(queries=6, anchors=1):
    seen = torch.rand(queries, CAMERAS) < 0.6
    seen[1] = False
    query, camera = seen.nonzero(as_tuple=True)
    counts = seen.sum(1)
    # up to 30 % beyond the border of the image
    points = (torch.rand(len(query), anchors, 2, dtype=torch.float64) * 2 - 1) * 1.3
    return Pairs(query, camera, points, counts, counts.cumsum(0) - counts)


def inputs(pairs):
    queries = len(pairs.counts)
    maps = [torch.randn(SAMPLES, CAMERAS, HEADS, CHANNELS, *size, dtype=torch.float64) for size in SIZES]
    offsets = torch.randn(HEADS, len(SIZES), 2, queries, POINTS, dtype=torch.float64) * 2
    attention = torch.rand(HEADS, len(SIZES), queries, POINTS, dtype=torch.float64)
    return [tensor.requires_grad_() for tensor in (offsets, attention, *maps)]


def ours(pairs, offsets, attention, *maps):
    levels = [make_level(pairs, *size, POINTS, HEADS, torch.float64) for size in SIZES]
    sums = deformable_sum([make_table(level) for level in maps], offsets, attention, levels)
    return sums.unflatten(-1, (SAMPLES, CHANNELS))


def by_grid_sample(pairs, offsets, attention, *maps):
    total = torch.zeros(HEADS, len(pairs.counts), SAMPLES, CHANNELS, dtype=torch.float64)
    for pair, (query, camera) in enumerate(zip(pairs.query.tolist(), pairs.camera.tolist(), strict=True)):
        for index, (level, (height, width)) in enumerate(zip(maps, SIZES, strict=True)):
            for head in range(HEADS):
                shift = offsets[head, index, :, query].T * 2 / torch.tensor([width, height])
                own = pairs.points[pair].repeat_interleave(POINTS // pairs.points.shape[1], dim=0)
                grid = (own + shift).expand(SAMPLES, 1, -1, -1)
                values = F.grid_sample(level[:, camera, head], grid, align_corners=False)[:, :, 0]
                part = (values * attention[head, index, query]).sum(-1)
                total = total.index_put((torch.tensor(head), torch.tensor(query)), part, accumulate=True)
    return total


@pytest.mark.parametrize("anchors", [1, 3])
def test_values_and_gradients_are_those_of_grid_sample(assert_same_gradients, anchors):
    pairs = make_pairs(anchors=anchors)
    tensors = inputs(pairs)
    result, expected = ours(pairs, *tensors), by_grid_sample(pairs, *tensors)
    assert_same_gradients(result, expected, tensors)


def test_heads_one_at_a_time_give_the_same_as_together(assert_same_gradients, monkeypatch):
    pairs = make_pairs()
    tensors = inputs(pairs)
    together = ours(pairs, *tensors)
    monkeypatch.setattr(deformable_attention, "TOGETHER", 1)
    assert make_level(pairs, *SIZES[0], POINTS, HEADS, torch.float64).heads == 1
    assert_same_gradients(ours(pairs, *tensors), together, tensors)


def test_a_query_no_camera_sees_gets_zeros():
    pairs = make_pairs()
    assert ours(pairs, *inputs(pairs))[:, 1].abs().max() == 0


@pytest.mark.parametrize("offset", [-1e6, 1e6])
def test_samples_far_outside_are_zero_and_finite(offset):
    pairs = make_pairs()
    offsets, attention, *maps = inputs(pairs)
    far = (torch.zeros_like(offsets) + offset).requires_grad_()
    result = ours(pairs, far, attention, *maps)
    assert result.abs().max() == 0
    gradient = torch.autograd.grad(result.sum(), far)[0]
    assert gradient.abs().max() == 0


def test_an_offset_that_is_not_a_number_shows_in_its_query_alone():
    pairs = make_pairs()
    offsets, attention, *maps = inputs(pairs)
    query = int(pairs.query[0])
    broken = offsets.detach().clone()
    broken[0, 0, 0, query, 0] = float("nan")
    broken.requires_grad_()
    result = ours(pairs, broken, attention, *maps)
    assert result[0, query].isnan().all()
    assert torch.equal(result[1], ours(pairs, offsets, attention, *maps)[1])
    result.sum().backward()
    assert broken.grad[0, :, :, query].isnan().any()
