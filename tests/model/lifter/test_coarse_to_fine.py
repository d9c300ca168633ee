import itertools
import math

import pytest
import torch
from by_hand import bilinear, middle_of

from omniocc.extras.rivals import CoarseToFine
from omniocc.extras.rivals.coarse_to_fine import cells_to_split
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.static import static_shapes
from omniocc.model.ops.visible import reference_points
from omniocc.model.sketch import Sketched

CYLINDER = Cylinder((8, 12, 4))
CUBOID = Cuboid((8, 8, 4), (-9.0, 8.0), (-7.0, 10.0), (-6.0, 7.0))
GRIDS = pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])
SIZES = [(9, 16), (5, 8)]
MOST = (0.6, 0.3)


def make(geometry, threshold=0.5, layers=(1, 2, 1), points=(2, 1, 2), most=MOST):
    sizes = {"layers": list(layers), "heads": 2, "points": list(points), "feedforward_channels": 8}
    choice = {"threshold": threshold, "most": list(most), "num_classes": 3}
    lifter = CoarseToFine(geometry, 8, 5, [4, 8], 4, (0.5, 24.5), **sizes, **choice).double()
    for coloring in lifter.colorings:  # away from the special values at which training begins
        torch.nn.init.normal_(coloring.empty)
        for layer in coloring.layers:
            torch.nn.init.normal_(layer.attention.offsets.weight, std=0.2)
            torch.nn.init.normal_(layer.attention.attention.weight, std=0.2)
    for classifier in lifter.classifiers:
        torch.nn.init.normal_(classifier.weight)
    return lifter


def make_features(batch=1):
    return [torch.randn(batch, 6, 8, *size, dtype=torch.float64) for size in SIZES]


def nothing(geometry, batch=1):
    return Sketched(torch.zeros(batch, *geometry.shape, dtype=torch.bool))


def attend(attention, query, features, pixels, seen, rig):
    """One query: mean over the cameras that see it of the weighted samples of every head, level and point."""
    heads, levels, points = attention.heads, attention.levels, attention.points
    offsets = attention.offsets(query).view(heads, levels, 2, points)
    weights = attention.attention(query).view(heads, levels * points).softmax(-1).view(heads, levels, points)
    total = torch.zeros(8, dtype=torch.float64)
    for camera in seen.nonzero().flatten().tolist():
        (u, v), model = pixels[camera].tolist(), rig.cameras[camera]
        for (level, maps), head, point in itertools.product(enumerate(features), range(heads), range(points)):
            values = attention.value(maps[camera].permute(1, 2, 0) + attention.level_embedding[level])
            column = (u + 0.5) * maps.shape[-1] / model.width - 0.5 + float(offsets[head, level, 0, point])
            row = (v + 0.5) * maps.shape[-2] / model.height - 0.5 + float(offsets[head, level, 1, point])
            part = slice(head * 4, head * 4 + 4)
            total[part] += weights[head, level, point] * bilinear(values[..., part], column, row)
    return attention.output(total / seen.sum())


def color(coloring, number, cell, start, features, rig):
    """One cell that is lifted."""
    query = coloring.embedding(coloring.positions[number]) + start
    pixels, seen = rig.project(middle_of(coloring.geometry, cell))
    for layer in coloring.layers if seen.any() else []:
        query = layer.attention_norm(query + attend(layer.attention, query, features, pixels, seen, rig))
        query = layer.feedforward(query)
    return query


def lift_by_loops(lifter, features, splat, rig):
    """One sample, a cell at a time: the volume, and which cells of each scale are lifted."""
    start = {cell: splat[(slice(None), *cell)] for cell in itertools.product(*map(range, splat.shape[1:]))}
    there, lifted = set(start), []
    for scale, coloring in enumerate(lifter.colorings):
        lifted.append(there)
        shape = coloring.geometry.shape
        volume = torch.zeros(8, *shape, dtype=torch.float64)
        for number, cell in enumerate(itertools.product(*map(range, shape))):
            own = start[cell]
            found = color(coloring, number, cell, own, features, rig) if cell in there else own + coloring.empty
            volume[(slice(None), *cell)] = found
        if scale == len(lifter.most):
            return torch.einsum("dc,cxyz->dxyz", lifter.out.weight, volume) + lifter.out.bias.view(-1, 1, 1, 1), lifted
        volume = lifter.mixers[scale](volume[None])[0]  # a convolution, tested where it is
        weight, bias = lifter.classifiers[scale].weight, lifter.classifiers[scale].bias
        chances = {}
        for cell in there:
            scores = (weight @ volume[(slice(None), *cell)] + bias).exp()
            chances[cell] = 1 - float(scores[0] / scores.sum())
        eligible = sorted((cell for cell in there if chances[cell] >= lifter.threshold), key=chances.get, reverse=True)
        chosen = eligible[: math.ceil(lifter.most[scale] * math.prod(shape))]
        steps = list(itertools.product((0, 1), repeat=3))
        there = {tuple(2 * k + s for k, s in zip(cell, step, strict=True)) for cell in chosen for step in steps}
        layer, start = lifter.parts[scale], {}
        for cell, step in itertools.product(itertools.product(*map(range, shape)), steps):
            part = tuple(2 * k + s for k, s in zip(cell, step, strict=True))
            start[part] = layer.weight @ volume[(slice(None), *cell)] + layer.bias
    raise AssertionError


@torch.no_grad()
@GRIDS
@pytest.mark.parametrize("threshold", [0.5, 0.8])
def test_equals_loops_over_scales_cells_and_cameras(fisheye, geometry, threshold):
    lifter, features = make(geometry, threshold), make_features()
    splat = lifter.splat(features, nothing(geometry), (fisheye,))[0]
    expected, lifted = lift_by_loops(lifter, [level[0] for level in features], splat, fisheye)
    assert all(0 < len(cells) < geometry.num_cells // 8 ** (2 - scale) for scale, cells in enumerate(lifted) if scale)
    # reference points are kept in float32
    result = lifter(features, nothing(geometry), (fisheye,))[0]
    torch.testing.assert_close(result, expected, rtol=1e-5, atol=1e-5)


@torch.no_grad()
@GRIDS
def test_batch_with_different_rigs_equals_single_samples(fisheye, pinhole, make_ring, geometry):
    lifter, features = make(geometry), make_features(4)
    rigs = (fisheye, pinhole, make_ring(4), fisheye)
    volumes, extras = lifter.with_extras(features, nothing(geometry, 4), rigs)
    for index, rig in enumerate(rigs):
        own = [level[index : index + 1] for level in features]
        alone, their = lifter.with_extras(own, nothing(geometry), (rig,))
        torch.testing.assert_close(volumes[index], alone[0])
        for together, single in zip(extras.coarse_logits, their.coarse_logits, strict=True):
            torch.testing.assert_close(together.logits[index], single.logits[0])
        with static_shapes():
            torch.testing.assert_close(lifter(own, nothing(geometry), (rig,)), alone)


def test_a_cell_is_split_if_it_is_occupied_or_unsure_and_among_the_likeliest():
    probability = torch.tensor([0.05, 0.2, 0.9, 0.3, 0.6, 0.95])  # of being occupied
    logits = torch.stack([1 - probability, probability / 2, probability / 2]).log().view(1, 3, 6, 1, 1)
    there = torch.tensor([True] * 5 + [False]).view(1, 6, 1, 1)
    chosen = lambda threshold, most: cells_to_split(logits, there, threshold, most).flatten().nonzero()[:, 0].tolist()  # noqa: E731
    assert chosen(0.1, 1.0) == [1, 2, 3, 4]
    assert chosen(0.5, 1.0) == [2, 4]
    assert chosen(0.1, 0.5) == [2, 3, 4]
    assert chosen(0.1, 0.4) == [2, 3, 4]  # 2.4 of 6 cells, rounded up
    assert chosen(0.99, 1.0) == []


def test_equal_probabilities_do_not_exceed_the_limit():
    there = torch.ones(2, 4, 4, 4, dtype=torch.bool)
    assert cells_to_split(torch.zeros(2, 3, 4, 4, 4), there, 0.1, 0.25).flatten(1).sum(1).tolist() == [16, 16]


def test_cost_grows_with_the_cells_that_are_split(fisheye):
    """The rows that pass through the attention of the finest scale are visible parts of cells that are split."""
    valid = reference_points(fisheye, CUBOID, torch.device("cpu"))[1].any(0).sum()
    rows = []
    for most in ((1.0, 1.0), (0.5, 0.25)):
        lifter = make(CUBOID, threshold=0.0, most=most)
        hook = lambda _, arguments: rows.append(arguments[0].shape[1])  # noqa: E731
        lifter.colorings[-1].layers[0].feedforward.register_forward_pre_hook(hook)
        lifter(make_features(), nothing(CUBOID), (fisheye,))
    assert rows[0] == valid
    assert 0 < rows[1] <= 0.25 * CUBOID.num_cells


def test_without_a_split_the_finest_cells_hold_what_their_coarse_cell_has(fisheye):
    lifter = make(CUBOID, threshold=1.0)
    volume = lifter(make_features(), nothing(CUBOID), (fisheye,))[0]
    blocks = volume.unfold(1, 2, 2).unfold(2, 2, 2).unfold(3, 2, 2).flatten(4)
    torch.testing.assert_close(blocks, blocks[..., :1].expand_as(blocks))
    volume.square().sum().backward()


@GRIDS
def test_training_reaches_every_parameter(fisheye, geometry):
    lifter = make(geometry, threshold=0.3)
    features = [level.requires_grad_() for level in make_features(2)]
    volume, extras = lifter.with_extras(features, nothing(geometry, 2), (fisheye, fisheye))
    assert [entry.block for entry in extras.coarse_logits] == [4, 2]
    outputs = (volume, *(entry.logits for entry in extras.coarse_logits))
    sum((output * torch.randn_like(output)).sum() for output in outputs).backward()
    for level in features:
        assert level.grad.abs().sum() > 0
    for name, parameter in lifter.named_parameters():
        # every cell of the coarsest scale is lifted
        assert parameter.grad.abs().sum() > 0 or name == "colorings.0.empty", name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": (2, 2)}, "points .* for each scale"),
        ({"most": (0.5,)}, "most .* for each but the finest"),
        ({"most": (0.5, 0.0)}, "fractions"),
        ({"threshold": 1.2}, "threshold is 1.2"),
        ({"geometry": Cuboid((6, 4, 4))}, "6x4x4.*4x4x4"),
    ],
)
def test_sizes_that_do_not_fit_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        make(**{"geometry": CUBOID} | change)
