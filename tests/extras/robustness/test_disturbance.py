import pickle
from functools import partial

import numpy as np
import pytest
import torch
from fake_source import FRAMES, FakeFrames

from omniocc.camera.masks import drop_random_cameras, usable_pixels
from omniocc.camera.miscalibrated import move_cameras, scale_focal_lengths, turn_cameras
from omniocc.data.source import SceneFrames
from omniocc.extras.robustness import disturbance as kinds
from omniocc.extras.robustness.disturbance import (
    DIRT_RGB,
    Disturbance,
    behind_dirt,
    disturb_scene,
    draw_dirt,
    draw_drops,
    through_drops,
)

NOISE = Disturbance(images=partial(kinds.noise, percent=5), each_frame=True)
DROPS = Disturbance(images=partial(kinds.drops_on_one_lens, percent=30))
DIRT = Disturbance(images=partial(kinds.dirt_on_one_lens, percent=30))
TURN = Disturbance(partial(turn_cameras, angle_deg=1.0))
TWO = Disturbance(partial(drop_random_cameras, count=2))
SEEN = np.zeros((72, 128), bool)
SEEN[:, 16:112] = True
IMAGE = np.random.default_rng(0).integers(0, 256, (72, 128, 3), dtype=np.uint8) * SEEN[..., None]


@pytest.fixture
def scene():
    """Four cameras, which shake from frame to frame."""
    return FakeFrames("street", 2)


def test_without_a_disturbance_everything_is_as_recorded(scene):
    same = disturb_scene(scene, Disturbance(), "undisturbed", 0)
    assert isinstance(same, SceneFrames)
    assert (same.name, len(same)) == ("street", FRAMES)
    assert tuple(same.rigs) == tuple(scene.rigs)
    assert all(map(np.array_equal, same.images(1), scene.images(1)))
    np.testing.assert_array_equal(same.world_from_ego, scene.world_from_ego)
    assert same.lidar(0) is None


@pytest.mark.parametrize("disturbance", [NOISE, DROPS, DIRT, TURN, TWO])
def test_frames_depend_on_scene_name_and_seed_alone(scene, disturbance):
    def content(scene, name="part", seed=0, read_before=()):
        frames = pickle.loads(pickle.dumps(disturb_scene(scene, disturbance, name, seed)))
        for frame in read_before:
            frames.images(frame)
        return [*frames.images(1), *(rig.fingerprint for rig in frames.rigs)]

    def equal(left, right):
        return all(map(np.array_equal, left, right))

    assert equal(content(scene), content(scene, read_before=(2, 0)))
    other = FakeFrames("another", 2)  # the same images under another name
    for changed in (content(scene, seed=1), content(scene, name="part2"), content(other)):
        if disturbance is not TWO:  # which has few choices
            assert not equal(content(scene), changed)


def test_a_calibration_is_as_wrong_in_all_frames_of_a_scene(scene):
    wrong = disturb_scene(scene, TURN, "turned", 0)
    errors = [
        torch.linalg.inv(true.ego_from_camera[:, :3, :3]) @ other.ego_from_camera[:, :3, :3]
        for true, other in zip(scene.rigs, wrong.rigs, strict=True)
    ]
    torch.testing.assert_close(errors[0], errors[1])
    assert all(map(np.array_equal, wrong.images(0), scene.images(0)))


def test_what_sits_on_a_lens_stays_and_noise_does_not(scene):
    for disturbance in (DROPS, DIRT):
        frames = disturb_scene(scene, disturbance, "lens", 0)
        changed = [
            [int((new != old).any(-1).sum()) for new, old in zip(frames.images(k), scene.images(k), strict=True)]
            for k in range(2)
        ]
        assert sum(count > 0 for count in changed[0]) == 1  # one lens
        assert np.argmax(changed[0]) == np.argmax(changed[1])
    noisy = disturb_scene(scene, NOISE, "noise", 0)
    noise = [noisy.images(k)[0].astype(int) - scene.images(k)[0] for k in range(2)]
    unclipped = [(scene.images(k)[0] > 60) & (scene.images(k)[0] < 190) for k in range(2)]
    both = unclipped[0] & unclipped[1]
    assert (noise[0] != noise[1])[both].mean() > 0.5


def test_dropped_cameras_are_black_and_masked(scene):
    frames = disturb_scene(scene, TWO, "two", 0)
    for frame in range(FRAMES):
        dark = [not image.any() for image in frames.images(frame)]
        masked = [not mask.any() for mask in usable_pixels(frames.rigs[frame])]
        assert dark == masked
        assert sum(dark) == 2
    one = Disturbance(partial(drop_random_cameras, count=9))
    assert sum(image.any() for image in disturb_scene(scene, one, "nine", 0).images(0)) == 1


def test_focal_lengths_are_too_long_and_too_short(scene):
    wrong = disturb_scene(scene, Disturbance(partial(scale_focal_lengths, percent=3)), "focal", 0)
    pairs = zip(scene.rigs[0].cameras, wrong.rigs[0].cameras, strict=True)
    ratios = [other.focal_px[0] / true.focal_px[0] for true, other in pairs]
    assert all(abs(ratio - 1) == pytest.approx(0.03) for ratio in ratios)


def test_cameras_are_moved_by_this_distance(scene):
    wrong = disturb_scene(scene, Disturbance(partial(move_cameras, distance_m=0.1)), "moved", 0)
    shift = wrong.rigs[1].ego_from_camera[:, :3, 3] - scene.rigs[1].ego_from_camera[:, :3, 3]
    torch.testing.assert_close(shift.norm(dim=1), torch.full((4,), 0.1, dtype=torch.float64))


def test_the_recorded_scene_is_behind_the_disturbed_one(scene):
    frames = disturb_scene(scene, TWO, "two", 0)
    assert frames.undisturbed is scene
    assert not hasattr(scene, "undisturbed")


@pytest.mark.parametrize("percent", [20, 60])
def test_drops_cover_this_much_of_what_the_lens_sees_and_stay_where_they_are(percent):
    drops = draw_drops(SEEN, percent, np.random.default_rng(3))
    covered = 100 * (drops.cover[SEEN] > 0.5).mean()
    assert percent <= covered < percent + 3
    assert not drops.cover[~SEEN].any()
    again = draw_drops(SEEN, percent, np.random.default_rng(3))
    assert all(map(np.array_equal, drops, again))


def test_a_drop_turns_its_view_upside_down():
    seen = np.ones((100, 100), bool)
    drops = draw_drops(seen, 0.1, np.random.default_rng(5))  # one drop
    rows, columns = np.nonzero(drops.cover > 0.99)
    top, bottom = rows.argmin(), rows.argmax()
    assert rows[bottom] > rows[top]
    assert drops.row[rows[bottom], columns[bottom]] < drops.row[rows[top], columns[top]]
    image = np.zeros((100, 100, 3), np.uint8)
    image[round(rows.mean()) :] = 200
    shown = through_drops(image, drops)
    np.testing.assert_array_equal(shown[drops.cover == 0], image[drops.cover == 0])
    assert shown[rows[top], columns[top]].mean() > 100 > shown[rows[bottom], columns[bottom]].mean()


@pytest.mark.parametrize("percent", [20, 60])
def test_dirt_hides_this_much(percent):
    dirt = draw_dirt(SEEN, percent, np.random.default_rng(2))
    assert 100 * (dirt[SEEN] > 0.5).mean() == pytest.approx(percent, abs=0.5)
    assert not dirt[~SEEN].any()
    shown = behind_dirt(IMAGE, dirt)
    assert (shown[dirt == 1] == DIRT_RGB).all()
    np.testing.assert_array_equal(shown[dirt == 0], IMAGE[dirt == 0])
    assert (dirt == 1).any()
    assert (dirt[SEEN] == 0).any()
