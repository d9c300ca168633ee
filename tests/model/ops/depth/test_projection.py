from dataclasses import replace

import pytest
import torch
from torch.nn import functional as F

from omniocc.camera import Equirectangular, Rig, normalize_pixels
from omniocc.model.depth import Spheres
from omniocc.model.ops.depth.projection import (
    Present,
    Projection,
    alternate_cameras,
    divided_samplers,
    field_weight,
    present_cameras,
    samplers,
    similarity,
    table,
)

PANORAMA = Equirectangular(24, 6, 45.0, -45.0)
SPHERES = Spheres(5, 1.6)
CPU = torch.device("cpu")
EVERYONE = torch.ones(2, 6, dtype=torch.bool)


def sampler_of(rig, cameras, planes=(0.0, 1.0, 2.5, 4.0)):
    blocks = samplers(rig, Projection(PANORAMA, SPHERES, (32, 18), cameras, planes), CPU)
    assert len(blocks) == 1
    return blocks[0]


def reference(rig, features, cameras, planes=(0.0, 1.0, 2.5, 4.0)):
    """Projects with the rig and samples with `grid_sample`; weights by the distance to the edge of the field."""
    points = torch.cat(
        [PANORAMA.rays().double().reshape(-1, 3) * (1 / (k * SPHERES.step_per_m) if k else 1e6) for k in planes]
    )
    pixels, valid = rig.project(points)
    total, weights = torch.zeros(len(features), features.shape[2], len(points), dtype=torch.float64), 0
    for k in cameras:
        grid = normalize_pixels(
            torch.where(valid[k, :, None], pixels[k], 0.0), rig.cameras[k].width, rig.cameras[k].height
        )
        grid = grid[None, None].expand(len(features), -1, -1, -1)
        sampled = F.grid_sample(features[:, k], grid, padding_mode="border", align_corners=False)[:, :, 0]
        nearest = torch.where(valid[k, :, None], pixels[k], 0.0).round().long()
        height, width = field_weight(rig, k).shape
        weight = field_weight(rig, k)[nearest[:, 1].clamp(0, height - 1), nearest[:, 0].clamp(0, width - 1)] * valid[k]
        total, weights = total + sampled * weight, weights + weight
    return (total / weights.clamp(min=1e-9)).permute(2, 0, 1), weights


@pytest.mark.parametrize("cameras", [(0,), (0, 2, 4), tuple(range(6))])
def test_features_on_spheres_equal_projection_and_bilinear_sampling(rig, cameras):
    torch.manual_seed(0)
    features = torch.randn(2, 6, 3, 18, 32)
    sampler = sampler_of(rig, cameras)
    expected, weights = reference(rig, features.double(), cameras)
    swept = sampler(table(features, Present.of(EVERYONE))).unflatten(1, (2, 3))
    torch.testing.assert_close(swept.double(), expected * (weights > 0)[:, None, None], atol=2e-5, rtol=0)
    assert torch.equal(sampler.seen, weights > 0)
    assert 0 < sampler.seen.float().mean() <= 1


def test_backward_is_the_transpose(rig):
    sampler = sampler_of(rig, (0, 2, 4))
    rows = torch.randn(6 * 18 * 32, 4, requires_grad=True)
    slope = torch.randn(sampler.matrix.shape[0], 4)
    (sampler(rows) * slope).sum().backward()
    torch.testing.assert_close(rows.grad, sampler.matrix.to_dense().T @ slope, atol=1e-5, rtol=1e-5)


def brute_similarity(rows, one, two, present, groups):
    dense = [sampler.matrix.to_dense() for sampler in (one, two)]
    pixels = present.T.float().repeat_interleave(18 * 32, 0)
    left, right = ((each @ rows).unflatten(1, (len(present), -1)) for each in dense)
    fractions = [each @ pixels for each in dense]
    left, right = (
        side / fraction.clamp(min=0.05)[..., None] for side, fraction in zip((left, right), fractions, strict=True)
    )
    gap = (left - right).square().unflatten(2, (groups, -1)).mean(-1)
    return torch.where((fractions[0] > 0) & (fractions[1] > 0), 1.0, 0.0)[..., None] / (1 + gap)


@pytest.mark.parametrize("missing", [None, 1])
def test_similarity_and_its_gradient(rig, missing):
    present = EVERYONE.clone()
    if missing is not None:
        present[0, missing] = False
    one, two = (sampler_of(rig, cameras) for cameras in alternate_cameras(rig))
    features = torch.randn(2, 6, 4, 18, 32, requires_grad=True)
    there = Present.of(present)
    ours, fraction_one, fraction_two = similarity(table(features, there), one, two, there, 2)
    slope = torch.randn_like(ours)
    (gradient,) = torch.autograd.grad((ours * slope).sum(), features)
    expected = brute_similarity(table(features, there), one, two, present, 2)
    (expected_gradient,) = torch.autograd.grad((expected * slope).sum(), features)
    torch.testing.assert_close(ours, expected, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(gradient, expected_gradient, atol=1e-4, rtol=1e-3)
    assert (fraction_one.amax(), fraction_two.amax()) == (pytest.approx(1), pytest.approx(1))


def test_what_a_missing_camera_saw_comes_from_the_others(rig):
    features = torch.full((1, 6, 1, 18, 32), 3.0)
    present = torch.tensor([[True, True, False, True, True, True]])
    sampler = sampler_of(rig, (0, 2, 4))
    fraction = sampler.present_fraction(Present.of(present))[:, 0]
    mean = sampler(table(features, Present.of(present)))[:, 0]
    assert ((fraction > 0) & (fraction < 1)).any()
    torch.testing.assert_close(mean, 3 * fraction)


def test_a_masked_camera_has_no_weight(rig):
    blind = torch.zeros(36, 64, dtype=torch.bool)
    masked = replace(rig, masks=(None, None, blind, None, None, None))
    matrix = sampler_of(masked, (0, 2, 4)).matrix
    camera = matrix.col_indices() // (18 * 32)
    assert set(camera.tolist()) == {0, 4}
    assert not field_weight(masked, 2).any()


def test_weight_falls_to_the_edge_of_the_field(rig):
    weight = field_weight(rig, 0)
    assert weight[18, 32] == 1
    assert 0 < weight[0, 32] < weight[1, 32] < weight[2, 32] <= 1
    assert not weight[~rig.rays(0)[1]].any()


def test_every_other_camera():
    assert alternate_cameras(Rig.load("fisheye6")) == ((1, 3, 5), (0, 2, 4)) or alternate_cameras(
        Rig.load("fisheye6")
    ) == ((0, 2, 4), (1, 3, 5))


def test_every_other_camera_whatever_their_order(make_ring):
    rig, order = make_ring(6), [3, 0, 5, 1, 4, 2]
    shuffled = Rig(rig.cameras, rig.ego_from_camera[order], tuple(f"{k}" for k in order))
    sets = {frozenset(order[k] for k in cameras) for cameras in alternate_cameras(shuffled)}
    assert sets == {frozenset({0, 2, 4}), frozenset({1, 3, 5})}
    assert alternate_cameras(make_ring(1)) == ((0,), ())


def test_black_images_are_missing():
    images = torch.rand(1, 3, 3, 4, 4)
    images[0, 1] = 0
    assert present_cameras(images).tolist() == [[True, False, True]]


def test_every_other_camera_in_the_order_of_angles(make_ring):
    rig = make_ring(5)
    points_m = 20 * PANORAMA.rays().double().reshape(-1, 3)
    valid = rig.project(points_m)[1]
    toward = F.normalize(points_m - rig.ego_from_camera[:, None, :3, 3], dim=-1)
    cosine = (toward * rig.ego_from_camera[:, None, :3, 2]).sum(-1)
    plane = SPHERES.index(torch.tensor(20.0)).item()
    (pair,) = divided_samplers(rig, Projection(PANORAMA, SPHERES, (32, 18), tuple(range(5)), (plane,)), CPU)
    for point in range(0, len(points_m), 7):
        order = sorted((k for k in range(5) if valid[k, point]), key=lambda k: -float(cosine[k, point]))
        for parity, sampler in enumerate(pair):
            first, last = sampler.matrix.crow_indices()[point : point + 2].tolist()
            used = set((sampler.columns[first:last] // (32 * 18)).tolist())
            assert used <= set(order[parity::2])
            assert used or not order[parity:] or len(order) < parity + 2


@pytest.mark.parametrize("count", [2, 3, 5])
def test_two_cameras_are_compared_wherever_two_see(count, make_ring):
    rig = make_ring(count)
    planes = (0.0, 2.0)
    (pair,) = divided_samplers(rig, Projection(PANORAMA, SPHERES, (32, 18), tuple(range(count)), planes), CPU)
    both = (pair[0].seen & pair[1].seen).unflatten(0, (2, -1))
    one = sampler_of(rig, tuple(range(count)), planes).seen.unflatten(0, (2, -1))
    points_m = PANORAMA.rays().double().reshape(-1, 3)
    for k, range_m in enumerate((1e6, 1 / (2.0 * SPHERES.step_per_m))):
        seen = rig.project(points_m * range_m)[1].sum(0)
        assert (both[k] == (seen >= 2)).float().mean() > 0.97  # weights are zero at the very rim
        assert not (both[k] & (seen < 2)).any()
        assert not (both[k] & ~one[k]).any()
