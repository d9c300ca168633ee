import pickle
from functools import cache

import numpy as np
import pytest
import torch

from omniocc.camera import Rig
from omniocc.errors import UserError
from omniocc.extras.robustness.parts import UNSEEN, chosen, parts_of
from omniocc.runs.robustness import UNDISTURBED
from omniworld.render.weather import WEATHERS

RIG = Rig.load("fisheye6").resized(64, 36)


@cache
def parts():
    return parts_of(RIG.names, ("oldtown",))


def test_names_are_unique_and_state_strength_and_unit():
    names = [part.name for part in parts()]
    assert len(set(names)) == len(names) == 48
    assert names[0] == UNDISTURBED
    some = """camera_rear_left_dropped two_cameras_dropped view_180_deg extrinsics_0.3_deg extrinsics_10_cm
    focal_3_percent camera_late_50_ms exposure_2_stops_under noise_5_percent blur_0.5_px jpeg_quality_20
    drops_on_one_lens_20_percent dirt_on_one_lens_60_percent weather_fog night"""
    assert {*some.split(), UNSEEN} <= set(names)


def test_every_part_changes_images_calibration_or_scenes_and_can_be_sent_to_other_processes():
    rng = np.random.default_rng(0)
    images = [np.random.default_rng(k).integers(0, 256, (36, 64, 3), dtype=np.uint8) for k in range(6)]
    for part in parts()[1:]:
        change = pickle.loads(pickle.dumps(part.disturbance))
        changed = bool(part.source)
        changed |= change.rig is not None and change.rig(RIG, rng) != RIG
        if change.images is not None:
            changed |= not all(map(np.array_equal, change.images(images, RIG, rng), images))
        assert changed, part.name


def test_parts_of_one_kind_get_stronger():
    """The calibration, by the pixels that a point moves."""
    point = np.array([6.0, 5.0, -1.0])

    def moved_px(name):
        part = next(part for part in parts() if part.name == name)
        wrong = part.disturbance.rig(RIG, np.random.default_rng(0))
        place = torch.from_numpy(point)
        return float((wrong.project(place)[0][0] - RIG.project(place)[0][0]).norm())

    for names in (
        [f"extrinsics_{n}_deg" for n in ("0.1", "0.3", "1", "3")],
        [f"extrinsics_{n}_cm" for n in (1, 3, 10)],
        [f"focal_{n}_percent" for n in (1, 3, 10)],
    ):
        moves = [moved_px(name) for name in names]
        assert moves == sorted(moves)
        assert moves[0] > 0


def test_words_choose_parts_or_whole_kinds():
    def names(*wanted):
        return [part.name for part in chosen(wanted, parts())]

    assert names("view_180_deg") == [UNDISTURBED, "view_180_deg"]
    assert names("view") == [UNDISTURBED, "view_270_deg", "view_180_deg", "view_90_deg"]
    assert names("night", "camera_dropped") == [UNDISTURBED, *(f"camera_{name}_dropped" for name in RIG.names), "night"]
    assert names("all") == [part.name for part in parts()]
    assert names("weather")[1:] == [f"weather_{name}" for name in WEATHERS]


def test_a_mistyped_part_is_answered_with_the_nearest():
    with pytest.raises(UserError, match=r"robustness=foacl: .*did you mean focal.*\n.*camera_dropped, .*night"):
        chosen(["foacl"], parts())
    with pytest.raises(UserError, match="robustness=qqqq: there is no such part\n"):
        chosen(["qqqq"], parts())


def test_places_never_trained_on_need_a_checkpoint_that_left_some_out():
    assert UNSEEN not in [part.name for part in parts_of(RIG.names, ())]
    with pytest.raises(UserError, match=r"data\.source\.test_places"):
        chosen([UNSEEN], parts_of(RIG.names, ()))


def test_a_rig_of_one_camera_loses_none():
    assert not [part for part in parts_of(("front",), ()) if "dropped" in part.name]
