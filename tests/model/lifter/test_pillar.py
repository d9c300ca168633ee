import itertools
import math

import pytest
import torch
from by_hand import bilinear

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.lifter import Pillar
from omniocc.model.lifter.pillar import pillar_anchors
from omniocc.model.sketch import Sketched

CYLINDER, CUBOID = Cylinder((2, 5, 4), (0.0, 12.0)), Cuboid((3, 3, 4), (-9.0, 8.0), (-7.0, 10.0), (-6.0, 7.0))
SIZES = [(9, 16), (5, 8)]


def make(geometry):
    lifter = Pillar(geometry, 8, 3, [4, 8], 2, heads=2, points=4, heights=2, feedforward_channels=12).double()
    for layer in lifter.coloring.layers:  # away from the special values at which training begins
        torch.nn.init.normal_(layer.attention.offsets.weight, std=0.2)
        torch.nn.init.normal_(layer.attention.attention.weight, std=0.2)
        torch.nn.init.normal_(layer.attention.level_embedding)
    return lifter


def everywhere(geometry, batch=1):
    return torch.ones(batch, *geometry.shape, dtype=torch.bool)


def attend(attention, query, features, pixels, seen, rig):
    """One pillar: mean over the cameras that see one of its heights of the weighted samples around those they see."""
    offsets = attention.offsets(query).view(2, 2, 2, 4)
    weights = attention.attention(query).view(2, 8).softmax(-1).view(2, 2, 4)
    total = torch.zeros(8, dtype=torch.float64)
    for camera in seen.any(1).nonzero().flatten().tolist():
        model = rig.cameras[camera]
        for (level, maps), head, point in itertools.product(enumerate(features), range(2), range(4)):
            height = point // 2
            if seen[camera, height]:
                u, v = pixels[camera, height].tolist()
                column = (u + 0.5) * maps.shape[-1] / model.width - 0.5 + float(offsets[head, level, 0, point])
                row = (v + 0.5) * maps.shape[-2] / model.height - 0.5 + float(offsets[head, level, 1, point])
                values = attention.value(maps[camera].permute(1, 2, 0) + attention.level_embedding[level])
                part = slice(head * 4, head * 4 + 4)
                total[part] += weights[head, level, point] * bilinear(values[..., part], column, row)
    return attention.output(total / seen.any(1).sum())


def middle_of_column(geometry, first, second, height_m):
    """Ego point of a column at a height, by hand."""
    (a, b), (c, d), _ = geometry.bounds
    one = a + (first + 0.5) * (b - a) / geometry.shape[0]
    two = c + (second + 0.5) * (d - c) / geometry.shape[1]
    if isinstance(geometry, Cylinder):
        one, two = one * math.cos(two), one * math.sin(two)
    return torch.tensor([one, two, height_m], dtype=torch.float64)


def lift_by_loops(lifter, geometry, features, rig):
    """One sample, a pillar at a time; heights are the middles of the lowest and the highest voxel."""
    low, high = geometry.bounds[2]
    step_m = (high - low) / geometry.shape[2]
    volume = torch.zeros(3, *geometry.shape, dtype=torch.float64)
    coloring = lifter.coloring
    for x, y in itertools.product(range(geometry.shape[0]), range(geometry.shape[1])):
        heights_m = (low + step_m / 2, high - step_m / 2)
        points_m = torch.stack([middle_of_column(geometry, x, y, height_m) for height_m in heights_m])
        pixels, seen = rig.project(points_m)
        query = coloring.embedding(coloring.positions[x * geometry.shape[1] + y])
        for layer in coloring.layers if seen.any() else []:
            query = layer.attention_norm(query + attend(layer.attention, query, features, pixels, seen, rig))
            query = layer.feedforward(query)
        for z in range(geometry.shape[2]):
            rows = slice(3 * z, 3 * z + 3)
            volume[:, x, y, z] = lifter.raise_up.weight[rows] @ query + lifter.raise_up.bias[rows]
    return volume


@torch.no_grad()
@pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])
def test_equals_loops_over_pillars_cameras_heads_levels_and_points(fisheye, geometry):
    lifter, features = make(geometry), [torch.randn(1, 6, 8, *size, dtype=torch.float64) for size in SIZES]
    expected = lift_by_loops(lifter, geometry, [level[0] for level in features], fisheye)
    # reference points are kept in float32
    torch.testing.assert_close(
        lifter(features, Sketched(everywhere(geometry)), (fisheye,))[0], expected, rtol=1e-5, atol=1e-5
    )


@torch.no_grad()
def test_batch_with_different_rigs_equals_single_samples(fisheye, pinhole):
    lifter, features = make(CUBOID), [torch.randn(2, 6, 8, *size, dtype=torch.float64) for size in SIZES]
    both = lifter(features, Sketched(everywhere(CUBOID, 2)), (fisheye, pinhole))
    for index, rig in enumerate((fisheye, pinhole)):
        single = lifter([level[index : index + 1] for level in features], Sketched(everywhere(CUBOID)), (rig,))
        torch.testing.assert_close(both[index], single[0])
    assert not torch.allclose(both[0], both[1])


@torch.no_grad()
def test_pillars_without_candidates_ignore_the_images(fisheye):
    lifter, candidates = make(CUBOID), ~everywhere(CUBOID)
    candidates[0, 1, 2, 3] = True
    first, second = (
        lifter([torch.randn(1, 6, 8, *size, dtype=torch.float64) for size in SIZES], Sketched(candidates), (fisheye,))[
            0
        ]
        for _ in range(2)
    )
    changed = (first != second).any(0)
    assert changed[1, 2].all()
    changed[1, 2] = False
    assert not changed.any()


def test_training_reaches_every_parameter(fisheye):
    lifter = make(CYLINDER).float()
    candidates = everywhere(CYLINDER)
    candidates[0, 0] = False
    volume = lifter([torch.randn(1, 6, 8, *size) for size in SIZES], Sketched(candidates), (fisheye,))
    (volume * torch.randn_like(volume)).sum().backward()
    for name, parameter in lifter.named_parameters():
        assert parameter.grad.abs().sum() > 0, name


def test_points_of_a_pillar_run_from_its_lowest_to_its_highest_voxel():
    heights = torch.tensor(pillar_anchors(8, 4), dtype=torch.float64)
    assert heights[:, :2].abs().max() == 0
    assert (heights[:, 2] + 0.5).tolist() == pytest.approx([0.5 / 8, 2.8333333 / 8, 5.1666667 / 8, 7.5 / 8])


def test_heights_must_divide_points():
    with pytest.raises(ValueError, match=r"4 points.* 3 anchors"):
        Pillar(CUBOID, 8, 3, [4], 1, heads=2, points=4, heights=3, feedforward_channels=8)
