"""What is wrong in disturbed batches, on samples of six, two and one cameras, and what stays."""

import dataclasses
import math

import pytest
import torch
from torch.nn import functional as F

from omniocc.batch import Batch
from omniocc.camera import Rig
from omniocc.camera.masks import usable_pixels
from omniocc.camera.models.mirrored import mirrored
from omniocc.data import Appearance, Augment, Disturbances
from omniocc.data.augment.disturbances import resize, wrong_rig
from omniocc.errors import UserError
from omniocc.geometry import Cuboid

GRID, WINDOW, HEIGHT, WIDTH = Cuboid((8, 8, 4)), 2, 36, 64
WAYS = ("camera", "rig", "scale", "image")
APPEARANCE = Appearance(0.5, 0.2, 0.1, 0.0, 1.0, 0.05, 0.3, 0.2, 0.5, 0.0)
LABELS = ("voxels", "erp_range_m", "lidar_range_m", "world_from_ego", "exists")
AUGMENT = dict.fromkeys(
    ("erase_probability", "brightness", "contrast", "saturation", "hue_deg", "flip_probability", "yaw_probability"), 0.0
) | {"erase_fraction": (0.02, 0.2), "erase_aspect": (0.5, 2.0), "drop_past_probability": 0.0}


def disturbances(*ways, **others):
    chosen = {f"{way}_probability": (1 / len(ways) if way in ways else 0.0) for way in WAYS}
    sizes = {"most_cameras": 2, "told_fraction": 0.5, "turn_deg": 3.0, "move_m": 0.1, "focal_percent": 10.0}
    sizes |= {"versions": 4, "scales": [0.5, 1.5, 2.0], "appearance": APPEARANCE}
    return Disturbances(**{**chosen, **sizes, **others})


def some(rig, names, sizes):
    """Return some cameras of a rig, with other sizes of images."""
    chosen = [rig.names.index(name) for name in names]
    cameras = tuple(rig.cameras[k].resized(*size) for k, size in zip(chosen, sizes, strict=True))
    return Rig(cameras, rig.ego_from_camera[chosen], tuple(names))


def rigs():
    six = Rig.load("fisheye6").resized(WIDTH, HEIGHT)
    body = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    body[-8:] = False
    six = dataclasses.replace(six, masks=(body,) * 6)
    return six, some(six, six.names[:2], [(48, 27), (32, 18)]), some(six, six.names[:1], [(48, 27)])


@pytest.fixture
def batch():
    generator = torch.Generator().manual_seed(0)
    three = rigs()
    moved = dataclasses.replace(three[0], ego_from_camera=three[0].raised(0.1).ego_from_camera)
    found = Batch(
        images=torch.randint(1, 256, (3, WINDOW, 6, 3, HEIGHT, WIDTH), generator=generator, dtype=torch.uint8),
        rigs=((moved, three[0]), (three[1],) * 2, (three[2],) * 2),
        world_from_ego=torch.eye(4, dtype=torch.float64).expand(3, WINDOW, 4, 4).clone(),
        frame_ids=("a/0", "b/0", "c/0"),
        voxels=torch.randint(0, 12, (3, *GRID.shape), generator=generator, dtype=torch.uint8),
        pixel_labels=torch.randint(0, 12, (3, 6, HEIGHT, WIDTH), generator=generator, dtype=torch.uint8),
        lidar_range_m=torch.rand(3, 50, generator=generator),
        erp_range_m=torch.rand(3, 6, 24, generator=generator),
        camera_range_m=torch.rand(3, 6, HEIGHT, WIDTH, generator=generator),
        depth_range_m=torch.rand(3, 6, 24, generator=generator),
        candidates=torch.rand(3, WINDOW, *GRID.shape, generator=generator) < 0.5,
        evidence=torch.randint(0, 256, (3, WINDOW, *GRID.shape), generator=generator, dtype=torch.uint8),
        exists=torch.ones(3, WINDOW, dtype=torch.bool),
    )
    mask = found.image_mask()
    return found._replace(
        images=found.images * mask.unsqueeze(3),
        pixel_labels=found.pixel_labels.masked_fill(~mask[:, -1], 255),
        camera_range_m=found.camera_range_m.masked_fill(~mask[:, -1], torch.nan),
    )


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def same(one, other):
    for name, mine, theirs in zip(Batch._fields, one, other, strict=True):
        if isinstance(mine, torch.Tensor):
            torch.testing.assert_close(mine, theirs, rtol=0, atol=0, equal_nan=True)
        else:
            assert mine == theirs, name


def test_off_draws_nothing_and_changes_nothing(batch):
    generator = seeded()
    before = generator.get_state()
    same(Augment(GRID, **AUGMENT, disturbances=None)(batch, generator), batch)
    assert torch.equal(generator.get_state(), before)


@pytest.mark.parametrize("way", WAYS)
def test_labels_stay_and_nothing_stored_does(way, batch):
    changed = Augment(GRID, **AUGMENT, disturbances=disturbances(way))(batch, seeded())
    for name in LABELS:
        assert torch.equal(getattr(changed, name), getattr(batch, name)), name
    assert changed.depth_range_m is changed.candidates is changed.evidence is None
    assert changed.images.dtype == torch.uint8
    assert not (changed.images * ~changed.image_mask().unsqueeze(3)).any(), "padding is black"


@pytest.mark.parametrize("way", WAYS)
def test_draws_depend_on_the_generator_alone(way, batch):
    disturb = disturbances(way)
    same(disturb(batch, seeded(3)), disturb(batch, seeded(3)))
    images = {disturb(batch, seeded(seed)).images.float().sum().item() for seed in range(8)}
    found = {disturb(batch, seeded(seed)).rigs for seed in range(8)}
    assert max(len(images), len(found)) > 2


def test_batches_are_disturbed_as_often_as_told(batch):
    way = disturbances("rig", rig_probability=0.3)
    hit = [way(batch, seeded(seed)).candidates is None for seed in range(300)]
    assert sum(hit) / 300 == pytest.approx(0.3, abs=0.07)
    every = disturbances("camera", "rig", "scale")
    assert all(every(batch, seeded(seed)).candidates is None for seed in range(30))


def test_images_change_besides_what_else_is_wrong(batch):
    alone = disturbances("rig", rig_probability=1.0)(batch, seeded(0))
    both = disturbances("rig", rig_probability=1.0, image_probability=1.0)(batch, seeded(0))
    assert torch.equal(alone.images, batch.images)
    assert not torch.equal(both.images, batch.images)
    assert all(believed != true for believed, true in zip(both.newest_rigs, batch.newest_rigs, strict=True))


@pytest.mark.parametrize("told", [0.0, 1.0])
def test_lost_cameras_are_black_in_all_frames_and_their_pixels_have_no_label(told, batch):
    lost = set()
    for seed in range(20):
        changed = disturbances("camera", told_fraction=told)(batch, seeded(seed))
        gone = ((changed.images == 0) & (batch.images > 0)).any(3)
        cameras = gone.flatten(3).any(3)
        assert torch.equal(cameras[:, 0], cameras[:, 1])
        lost.add(tuple(cameras[:, 0].sum(1).tolist()))
        assert torch.equal(changed.images, batch.images * ~gone.unsqueeze(3))
        assert torch.equal(changed.pixel_labels, batch.pixel_labels.masked_fill(gone[:, -1], 255))
        expected = batch.camera_range_m.masked_fill(gone[:, -1], torch.nan)
        torch.testing.assert_close(changed.camera_range_m, expected, equal_nan=True)
        for sample, before in enumerate(batch.newest_rigs):
            after = usable_pixels(changed.newest_rigs[sample])
            for camera, mask in enumerate(usable_pixels(before)):
                rows, columns = mask.shape
                region = gone[sample, -1, camera, :rows, :columns]
                if told:  # as in the robustness test
                    assert torch.equal(after[camera], mask & ~region)
                    assert not region.any() or not after[camera].any()
                else:
                    assert torch.equal(after[camera], mask)
                    assert region.all() == region.any()
    assert lost == {(1, 1, 0), (2, 1, 0)}, "one or two of six, one of two, none of one"


def test_wrong_rigs_are_a_few_versions_of_the_true_ones(batch):
    found = [disturbances("rig")(batch, seeded(seed)) for seed in range(40)]
    assert all(torch.equal(one.images, batch.images) for one in found)
    assert all(torch.equal(one.pixel_labels, batch.pixel_labels) for one in found)
    for sample, true in enumerate(batch.newest_rigs):
        wrong = {one.newest_rigs[sample] for one in found}
        assert len(wrong) == 4
        assert true not in wrong
        for rig in wrong:
            for k, (camera, other) in enumerate(zip(true.cameras, rig.cameras, strict=True)):
                error = true.ego_from_camera[k, :3, :3].T @ rig.ego_from_camera[k, :3, :3]
                assert 0 < math.degrees(math.acos(min(1.0, (float(error.trace()) - 1) / 2))) <= 3.0
                assert 0 < float((true.ego_from_camera[k, :3, 3] - rig.ego_from_camera[k, :3, 3]).norm()) <= 0.1
                assert 0 < abs(other.focal_px / camera.focal_px - 1) <= 0.1001
                assert (camera.width, camera.height) == (other.width, other.height)
    errors = [
        wrong.ego_from_camera[:, :3, 3] - true.ego_from_camera[:, :3, 3]
        for wrong, true in zip(found[0].rigs[0], batch.rigs[0], strict=True)
    ]
    torch.testing.assert_close(*errors)  # a window of moving cameras has one error


def test_errors_of_0_are_none():
    six = rigs()[0]
    assert wrong_rig(six, "a", 1, 0.0, 0.0, 0.0) == six
    assert wrong_rig(six, "a", 1, 1.0, 0.0, 0.0) != wrong_rig(six, "b", 1, 1.0, 0.0, 0.0)


def test_a_camera_without_a_focal_length_is_named():
    six = rigs()[0]
    flipped = dataclasses.replace(six, cameras=tuple(map(mirrored, six.cameras)))
    with pytest.raises(UserError, match=r"focal_percent=10: Mirrored has no centre.*give 0"):
        wrong_rig(flipped, "a", 1, 1.0, 0.0, 10.0)


def test_scaled_images_show_the_same_in_the_same_directions(batch):
    smooth = F.interpolate(batch.images[..., ::12, ::16].flatten(0, 2).float(), (HEIGHT, WIDTH), mode="bilinear")
    smooth = smooth.view(batch.images.shape).byte() * batch.image_mask().unsqueeze(3)
    found = {}
    for seed in range(20):
        changed = disturbances("scale")(batch._replace(images=smooth), seeded(seed))
        scale = changed.newest_rigs[0].cameras[0].width / WIDTH
        found[scale] = changed
        for frames, before in zip(changed.rigs, batch.rigs, strict=True):
            for rig, old in zip(frames, before, strict=True):
                assert torch.equal(rig.ego_from_camera, old.ego_from_camera)
                for camera, was in zip(rig.cameras, old.cameras, strict=True):
                    assert camera == was.resized(camera.width, camera.height)
    assert sorted(found) == [0.5, 1.5, 2.0]
    twice = found[2.0]
    assert twice.images.shape == (3, WINDOW, 6, 3, 2 * HEIGHT, 2 * WIDTH)
    assert torch.equal(twice.pixel_labels, batch.pixel_labels.repeat_interleave(2, -1).repeat_interleave(2, -2))
    ranges = batch.camera_range_m.repeat_interleave(2, -1).repeat_interleave(2, -2)
    torch.testing.assert_close(twice.camera_range_m, ranges, rtol=0, atol=0, equal_nan=True)
    assert [c.width for c in twice.newest_rigs[1].cameras] == [96, 64]
    shrunk = F.avg_pool2d(twice.images.flatten(0, 2).float(), 2).view(smooth.shape)
    inside = twice.image_mask()[..., ::2, ::2].unsqueeze(3)
    assert float(((shrunk - smooth).abs() * inside).max()) < 12
    assert found[0.5].images.shape[-2:] == (18, 32)


def test_resizing_keeps_to_the_images_of_each_camera():
    one, other = (rig.scaled(1.5) for rig in rigs()[1:])
    values = torch.full((2, 2, 1, 27, 48), 7, dtype=torch.uint8)
    values[1, 1] = 9  # a camera that the second sample does not have
    pairs = [(rigs()[1], one), (rigs()[2], other)]
    found = resize(values, pairs, 255)
    sizes = [(camera.height, camera.width) for camera in (*one.cameras, *other.cameras)]
    assert [int((found[s, c] == 7).sum()) for s, c in ((0, 0), (0, 1), (1, 0))] == [h * w for h, w in sizes]
    assert (found[1, 1] == 255).all()


def test_changed_images_change_alike_in_all_frames(batch):
    batch = batch._replace(images=batch.images[:, :1].expand(-1, WINDOW, -1, -1, -1, -1))
    changed = disturbances("image")(batch, seeded(1))
    assert torch.equal(changed.images[:, 0], changed.images[:, 1])
    assert not torch.equal(changed.images, batch.images)
    assert changed.rigs == batch.rigs


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"camera_probability": 0.6, "rig_probability": 0.6}, r"1\.2 together, above 1"),
        ({"focal_percent": 100.0}, r"focal_percent is 100\.0"),
        ({"scales": []}, r"scales are \[\]"),
        ({"scales": [1.0, 0.0]}, r"scales are \[1\.0, 0\.0\]"),
    ],
)
def test_values_that_make_no_sense_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        disturbances(**wrong)
