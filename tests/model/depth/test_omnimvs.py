from dataclasses import replace

import pytest
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.camera.parallax import pixels_per_metre
from omniocc.model.depth import Spheres
from omniocc.model.depth.omnimvs import HINTS, PROBES_M, rig_hints
from omniocc.model.ops.depth import projection
from omniocc.model.ops.rig_cache import RIG_CACHE

PANORAMA, SPHERES = Equirectangular(24, 8, 60.0, -60.0), Spheres(16, 1.5)


@pytest.mark.parametrize(("name", "stride"), [("OmniMVS", 1), ("OmniMVS", 2), ("OmniMVS3D", 2)])
def test_turning_the_car_by_one_camera_turns_the_panorama(name, stride, small, make_ring):
    # camera k takes the place of camera k + 1: the world turns by 60 degrees, 8 columns of 48; the sets change places
    rig = make_ring(6)
    model = small(name, sweep_stride=stride).eval()
    torch.manual_seed(0)
    images = torch.rand(1, 6, 3, 36, 64)
    with torch.no_grad():
        logits, _ = model.logits(images, rig)
        turned, _ = model.logits(images.roll(1, 1), rig)
    torch.testing.assert_close(turned, logits.roll(8, -1), atol=2e-3, rtol=1e-3)
    assert not torch.allclose(turned, logits, atol=0.1)


@pytest.mark.parametrize(("name", "changes"), [("OmniMVS", {}), ("OmniMVS", {"feature_stride": 1}), ("OmniMVS3D", {})])
def test_the_mirrored_world(name, changes, small, make_ring):
    # a rig of even symmetry: mirroring images and the order of cameras mirrors the world
    rig = make_ring(6)
    model = small(name, **changes).eval()
    torch.manual_seed(0)
    images = torch.rand(1, 6, 3, 36, 64)
    mirrored = images.flip(-1)[:, [0, 5, 4, 3, 2, 1]]
    with torch.no_grad():
        expected, _ = model.logits(mirrored, rig)
        ours, _ = model.logits(images, rig, flip=True)
    torch.testing.assert_close(ours, expected, atol=2e-3, rtol=1e-3)


def test_panoramas_larger_than_a_block_of_the_sweep(small, rig, monkeypatch):
    images, model = torch.rand(1, 6, 3, 36, 64), small("OmniMVS").eval()
    with torch.no_grad():
        expected, _ = model.logits(images, rig)
        monkeypatch.setattr(projection, "BLOCK_ROWS", 100)  # of 576 points on each sphere
        RIG_CACHE.clear()
        ours, _ = model.logits(images, rig)
    RIG_CACHE.clear()
    torch.testing.assert_close(ours, expected, atol=1e-4, rtol=1e-4)


def test_order_of_cameras_does_not_matter(small, make_ring):
    rig, order = make_ring(6), [4, 1, 0, 5, 3, 2]
    shuffled = Rig(rig.cameras, rig.ego_from_camera[order], tuple(rig.names[k] for k in order))
    model = small("OmniMVS").eval()
    images = torch.rand(1, 6, 3, 36, 64)
    with torch.no_grad():
        ours, _ = model.logits(images[:, order], shuffled)
        expected, _ = model.logits(images, rig)
    torch.testing.assert_close(ours, expected, atol=2e-3, rtol=1e-3)


def test_the_true_range_is_not_used(small, rig):
    model = small("OmniMVS").eval()
    images = torch.rand(1, 6, 3, 36, 64)
    with torch.no_grad():
        one, two = model(images, (rig,), torch.full((1, 12, 48), 3.0)), model(images, (rig,))
    assert all(torch.equal(ours, expected) for ours, expected in zip(one, two, strict=True))


@pytest.mark.parametrize("name", ["OmniMVS", "OmniMVS3D"])
def test_where_sky_is_likelier_the_range_stands_but_is_not_valid(name, small, rig, monkeypatch):
    model = small(name)
    logits = torch.zeros(1, 9, 12, 48)  # eight spheres and the sky
    logits[:, 3], logits[:, 8, :5], logits[:, 8, 5:] = 20.0, 2.0, -2.0
    monkeypatch.setattr(model, "logits", lambda images, rig: (logits, torch.ones(1, 12, 48, dtype=torch.bool)))
    depth = model(torch.rand(1, 6, 3, 36, 64), (rig,))
    torch.testing.assert_close(depth.index, torch.full((1, 12, 48), 3.0))
    assert depth.valid[:, 5:].all()
    assert not depth.valid[:, :5].any()
    assert depth.confidence[0, :, 0].unique().tolist() == pytest.approx([0.1192, 0.8808], abs=1e-3)


def test_uncertain_answers_are_not_valid(small, rig):
    images = torch.rand(1, 6, 3, 36, 64)
    models = [small("OmniMVS", min_confidence=level).eval() for level in (0.0, 0.9)]
    with torch.no_grad():
        for model in models:
            model.fine[-1].bias[-1] = -6  # hardly any sky
        free, strict = (model(images, (rig,)) for model in models)
    assert torch.equal(strict.valid, free.valid & (free.confidence >= 0.9))
    assert free.valid.any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"groups": 3}, "4 match_channels.* 3"),
        ({"sweep_stride": 3}, "sweep_stride is 3"),
        ({"feature_stride": 3}, "stride of the features is 3"),
        ({"width": 46}, "46x12 px.*multiples of 4"),
    ],
)
def test_sizes_that_do_not_fit_are_named(changes, words, small):
    with pytest.raises(ValueError, match=words):
        small("OmniMVS", **changes)


def test_with_pairs_by_angle_any_order_of_any_number_of_cameras_gives_one_answer(small, make_ring):
    model = small("OmniMVS", pairs="nearest", hints=True).eval()
    for count, order in ((3, [2, 0, 1]), (5, [4, 1, 0, 3, 2])):
        rig = make_ring(count)
        shuffled = Rig(rig.cameras, rig.ego_from_camera[order], tuple(rig.names[k] for k in order))
        images = torch.rand(1, count, 3, 36, 64)
        with torch.no_grad():
            ours, _ = model.logits(images[:, order], shuffled)
            expected, _ = model.logits(images, rig)
        torch.testing.assert_close(ours, expected, atol=2e-3, rtol=1e-3)


def test_the_height_of_the_road_is_an_input_that_half_of_the_training_lacks(small, make_ring):
    rig = make_ring(4)
    model = small("OmniMVS", hints=True).eval()
    images = torch.rand(1, 4, 3, 36, 64)
    with torch.no_grad():
        answers = [model.logits(images, replace(rig, road_z_m=z))[0] for z in (None, -1.0, -2.0)]
    assert not torch.allclose(answers[0], answers[1])
    assert not torch.allclose(answers[1], answers[2])
    told, sweep = [], model.sweep
    model.sweep = lambda features, present, rig: told.append(rig.road_z_m) or sweep(features, present, rig)
    for seed in range(40):
        generator = torch.Generator().manual_seed(seed)
        model.weighted_losses(images, (replace(rig, road_z_m=-1.0),), torch.full((1, 12, 48), 5.0), None, generator)
    assert set(told) == {None, -1.0}
    assert 8 < told.count(None) < 32


def test_an_unknown_way_to_pair_is_named(small):
    with pytest.raises(ValueError, match="pairs is odd"):
        small("OmniMVS", pairs="odd")


def test_the_road_is_where_a_flat_road_is(rig):
    maps = rig_hints(replace(rig, road_z_m=-1.4), PANORAMA, SPHERES)
    assert maps.shape == (HINTS, 8, 24)
    rays = PANORAMA.rays()
    for row in range(8):
        if rays[row, 0, 2] >= 0:
            assert not maps[3, row].any()
        else:
            range_m = -1.4 / rays[row, :, 2]
            torch.testing.assert_close(maps[3, row], (SPHERES.index(range_m) / 16).clamp(max=1), atol=1e-5, rtol=1e-5)
    assert (maps[4] == 1).all()
    unknown = rig_hints(replace(rig, road_z_m=None), PANORAMA, SPHERES)
    assert not unknown[3:].any()
    assert torch.equal(unknown[:3], maps[:3])


def test_parallax_is_per_sphere_and_cameras_are_counted(rig):
    maps = rig_hints(rig, PANORAMA, SPHERES)
    rays = PANORAMA.rays().double()
    for found, range_m in zip(maps, PROBES_M, strict=False):
        near = pixels_per_metre(rig, rays * range_m) * range_m**2 * SPHERES.step_per_m
        torch.testing.assert_close(found.double().expm1(), near, atol=1e-4, rtol=1e-4)
    assert maps[2].max() <= 1
    assert maps[2, 4, 0] == pytest.approx(float(rig.project(rays[4, 0] * 1e3)[1].sum()) / 4)
