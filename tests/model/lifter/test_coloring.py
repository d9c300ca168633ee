import contextlib
import itertools

import pytest
import torch
from by_hand import bilinear

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.lifter import Coloring
from omniocc.model.lifter.coloring import position_features
from omniocc.model.ops.evidence import network_inputs, unpack_evidence
from omniocc.model.ops.static import static_shapes
from omniocc.model.ops.visible import group_samples, reference_points
from omniocc.model.sketch import Sketched

GRID = Cylinder((4, 8, 3))
SIZES = [(9, 16), (5, 8)]


def make(geometry=GRID, layers=2, **options):
    lifter = Coloring(geometry, 8, [4, 8], layers, heads=2, points=2, feedforward_channels=12, **options).double()
    for layer in lifter.layers:  # away from the special values at which training begins
        torch.nn.init.normal_(layer.attention.offsets.weight, std=0.2)
        torch.nn.init.normal_(layer.attention.attention.weight, std=0.2)
        torch.nn.init.normal_(layer.attention.level_embedding)
    torch.nn.init.normal_(lifter.empty)
    return lifter


def make_features(batch=2):
    return [torch.randn(batch, 6, 8, *size, dtype=torch.float64) for size in SIZES]


def cells_at(grid, anchor):
    """Points of a cylinder's or cuboid's cells, by hand."""
    first, second, third = (
        (torch.arange(cells, dtype=torch.float64) + 0.5 + part) * (high - low) / cells + low
        for cells, (low, high), part in zip(grid.shape, grid.bounds, anchor, strict=True)
    )
    first, second, third = torch.meshgrid(first, second, third, indexing="ij")
    if isinstance(grid, Cylinder):
        first, second = first * second.cos(), first * second.sin()
    return torch.stack([first, second, third], dim=-1).reshape(-1, 3)


def attend(attention, query, features, pixels, seen, rig):
    """One query, one sample: mean over its cameras of the weighted samples of every head, level and point."""
    heads, levels, points = attention.heads, attention.levels, attention.points
    offsets = attention.offsets(query).view(heads, levels, 2, points)
    weights = attention.attention(query).view(heads, levels * points).softmax(-1).view(heads, levels, points)
    total = torch.zeros(8, dtype=torch.float64)
    for camera in seen.any(1).nonzero().flatten().tolist():
        for level, maps in enumerate(features):
            height, width = maps.shape[-2:]
            values = attention.value(maps[camera].permute(1, 2, 0) + attention.level_embedding[level])
            for head, point in itertools.product(range(heads), range(points)):
                anchor = point * seen.shape[1] // points
                if seen[camera, anchor]:
                    u, v = pixels[camera, anchor].tolist()
                    column = (u + 0.5) * width / rig.cameras[camera].width - 0.5
                    row = (v + 0.5) * height / rig.cameras[camera].height - 0.5
                    part = slice(head * 4, head * 4 + 4)
                    du, dv = offsets[head, level, :, point].tolist()
                    sample = bilinear(values[..., part], column + du, row + dv)
                    total[part] += weights[head, level, point] * sample
    return attention.output(total / seen.any(1).sum())


def color_by_loops(lifter, features, candidates, rig, inputs=None, start=None):
    """The coloring module for one sample, a voxel at a time; `inputs` of the evidence and `start` are (C, cells)."""
    points_m = torch.stack([cells_at(lifter.geometry, anchor) for anchor in lifter.anchors], dim=1)
    pixels, valid = rig.project(points_m)
    start = torch.zeros(8, candidates.numel(), dtype=torch.float64) if start is None else start
    volume = lifter.empty + start.T
    for cell in candidates.flatten().nonzero().flatten().tolist():
        query = lifter.embedding(lifter.positions[cell]) + start[:, cell]
        if inputs is not None:
            query = query + lifter.evidence(inputs[:, cell])
        for layer in lifter.layers if valid[:, cell].any() else []:
            mixed = attend(layer.attention, query, features, pixels[:, cell], valid[:, cell], rig)
            query = layer.attention_norm(query + mixed)
            query = layer.feedforward(query)
        volume[cell] = query
    return volume.T.reshape(-1, *lifter.geometry.shape)


HEIGHTS = ((0.0, 0.0, -0.5), (0.0, 0.0, 0.5))
RADII = ((-0.25, 0.0, 0.0), (0.25, 0.0, 0.0))


@torch.no_grad()
@pytest.mark.parametrize("anchors", [((0.0, 0.0, 0.0),), HEIGHTS, RADII], ids=["centre", "heights", "radii"])
@pytest.mark.parametrize("geometry", [GRID, Cuboid((6, 5, 3), height_m=(-8.0, 9.0))], ids=["cylinder", "cuboid"])
def test_equals_loops_over_voxels_cameras_heads_levels_and_points(fisheye, geometry, anchors):
    lifter, features = make(geometry, anchors=anchors), make_features(batch=1)
    candidates = torch.rand(1, *geometry.shape) < 0.6
    expected = color_by_loops(lifter, [level[0] for level in features], candidates[0], fisheye)
    result = lifter(features, Sketched(candidates), (fisheye,))
    seen = torch.stack([reference_points(fisheye, geometry, torch.device("cpu"), (one,))[1] for one in anchors])
    assert len(anchors) == 1 or (seen.any(0) & ~seen.all(0)).any()  # a camera that sees one anchor and not the other
    # reference points are kept in float32
    torch.testing.assert_close(result[0], expected, rtol=1e-5, atol=1e-5)


@torch.no_grad()
def test_evidence_is_added_to_the_queries_of_each_sample(fisheye):
    lifter, features = make(evidence=True), make_features()
    candidates = (torch.rand(1, *GRID.shape) < 0.6).expand(2, -1, -1, -1)
    bits = torch.randint(0, 256, (2, *GRID.shape), dtype=torch.uint8)
    evidence = unpack_evidence(bits).double()
    result = lifter.color(features, candidates, (fisheye, fisheye), evidence)
    for index in range(2):
        inputs = network_inputs(evidence)[index].flatten(1)
        expected = color_by_loops(lifter, [level[index] for level in features], candidates[index], fisheye, inputs)
        torch.testing.assert_close(result[index], expected, rtol=1e-5, atol=1e-5)
    with pytest.raises(ValueError, match="choose model/sketch=omni"):
        lifter(features, Sketched(candidates), (fisheye, fisheye))
    of_bits = lifter.float()([level.float() for level in features], Sketched(candidates, bits), (fisheye, fisheye))
    torch.testing.assert_close(of_bits, result.float(), rtol=1e-4, atol=1e-4)


@torch.no_grad()
@pytest.mark.parametrize("static", [False, True])
def test_queries_may_start_from_features_of_each_sample(fisheye, pinhole, static):
    lifter, features, rigs = make(), make_features(batch=3), (fisheye, pinhole, fisheye)
    candidates = torch.rand(3, *GRID.shape) < 0.6
    candidates[2] = candidates[0]
    start = torch.randn(3, 8, *GRID.shape, dtype=torch.float64)
    for index in range(3):
        part = slice(index, index + 1)
        own = [level[part] for level in features]
        with static_shapes() if static else contextlib.nullcontext():
            single = lifter.color(own, candidates[part], rigs[part], start=start[part])[0]
        expected = color_by_loops(
            lifter, [level[0] for level in own], candidates[index], rigs[index], start=start[index].flatten(1)
        )
        torch.testing.assert_close(single, expected, rtol=1e-5, atol=1e-5)
        if not static:
            together = lifter.color(features, candidates, rigs, start=start)
            torch.testing.assert_close(together[index], single)


@torch.no_grad()
def test_batch_with_different_rigs_and_candidate_counts_equals_single_samples(fisheye, pinhole):
    lifter, features = make(), make_features(batch=4)
    candidates = torch.rand(4, *GRID.shape) < torch.tensor([0.2, 0.9, 0.5, 0.0])[:, None, None, None]
    candidates[2] = candidates[0]
    rigs = (fisheye, pinhole, fisheye, pinhole)
    both = lifter(features, Sketched(candidates), rigs)
    for index, rig in enumerate(rigs):
        single = lifter(
            [level[index : index + 1] for level in features], Sketched(candidates[index : index + 1]), (rig,)
        )
        torch.testing.assert_close(both[index], single[0])


def test_samples_are_grouped_by_rig_and_candidates(fisheye, pinhole):
    marked = torch.tensor([[True, False], [True, True], [True, False], [True, False]])
    assert group_samples((fisheye, fisheye, pinhole, fisheye), marked) == [[0, 3], [1], [2]]


@torch.no_grad()
def test_unseen_voxels_and_non_candidates_ignore_the_images(fisheye):
    geometry = Cuboid((6, 6, 4), height_m=(-8.0, 30.0))
    lifter = make(geometry)
    candidates = torch.rand(1, *geometry.shape) < 0.7
    valid = reference_points(fisheye, geometry, torch.device("cpu"))[1].any(0).reshape(geometry.shape)
    first = lifter(make_features(1), Sketched(candidates), (fisheye,))[0].movedim(0, -1)
    second = lifter(make_features(1), Sketched(candidates), (fisheye,))[0].movedim(0, -1)
    unseen, seen = candidates[0] & ~valid, candidates[0] & valid
    assert unseen.any()
    assert seen.any()
    assert torch.equal(first[unseen], second[unseen])
    torch.testing.assert_close(first[unseen], lifter.embedding(lifter.positions[unseen.flatten()]))
    assert (first[seen] != second[seen]).any(-1).all()
    assert torch.equal(first[~candidates[0]], lifter.empty.expand(int((~candidates).sum()), -1))


def test_training_works_without_candidates(fisheye):
    lifter = make()
    lifter(make_features(1), Sketched(torch.zeros(1, *GRID.shape, dtype=torch.bool)), (fisheye,)).sum().backward()
    assert lifter.empty.grad.abs().sum() > 0


def test_cost_grows_with_candidates(fisheye):
    """The rows that pass through the feed-forward part are the visible candidates, no more."""
    lifter = make(layers=1)
    rows = []
    lifter.layers[0].feedforward.register_forward_pre_hook(lambda _, arguments: rows.append(arguments[0].shape[1]))
    valid = reference_points(fisheye, GRID, torch.device("cpu"))[1].any(0).reshape(GRID.shape)
    for fraction in (0.1, 0.5, 1.0):
        candidates = torch.rand(1, *GRID.shape) < fraction
        lifter(make_features(1), Sketched(candidates), (fisheye,))
        assert rows[-1] == int((candidates[0] & valid).sum())


def test_positions_do_not_jump_where_the_azimuth_does():
    features = position_features(Cylinder((2, 720, 2))).reshape(2, 720, 2, -1)
    steps = (features - features.roll(1, dims=1)).abs().amax(dim=(0, 2, 3))
    assert steps[0] <= 1.01 * steps[1:].max()
    assert features.abs().max() <= 1 + 1e-6


def test_a_rig_with_other_cameras_than_the_images_is_named(fisheye):
    features = [level[:, :4] for level in make_features(1)]
    with pytest.raises(ValueError, match=r"6 cameras.*images.* 4"):
        make()(features, Sketched(torch.ones(1, *GRID.shape, dtype=torch.bool)), (fisheye,))


@pytest.mark.parametrize(
    ("anchors", "message"),
    [
        ([], "2 points.* 0 anchors"),
        ([(0.0, 0.0, 0.0)] * 3, "2 points.* 3 anchors"),
        ([(0.0, 0.0, 0.6)], "-0.5.*0.5"),
    ],
)
def test_points_are_split_among_anchors_within_the_cell(anchors, message):
    with pytest.raises(ValueError, match=message):
        make(anchors=anchors)


def test_heads_must_divide_channels():
    with pytest.raises(ValueError, match=r"8 channels.* 3 heads"):
        Coloring(GRID, 8, [4], layers=1, heads=3, points=1, feedforward_channels=8)
