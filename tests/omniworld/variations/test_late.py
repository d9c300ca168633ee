import numpy as np

from omniocc.camera import Rig
from omniworld import Scene
from omniworld.variations.late import LateCamera

RIG = Rig.load("fisheye6").resized(64, 36)
OPTIONS = {"weather": "overcast", "lidars": 1, "erp_size": (16, 4), "supersample": 1, "frame_interval_s": 0.1}


def test_one_camera_shows_what_it_saw_before():
    scene = Scene("suburb", 4, RIG, **OPTIONS)
    frames = [scene.frame(index) for index in range(3)]
    late = LateCamera(Scene("suburb", 4, RIG, **OPTIONS), 2, 0.2, 4).frame(2)
    np.testing.assert_array_equal(late.semantics[2], frames[0].semantics[2])
    np.testing.assert_array_equal(late.range_m[2], frames[0].range_m[2])
    assert np.abs(late.images[2].astype(int) - frames[0].images[2]).mean() < 6  # their noise differs
    others = [0, 1, 3, 4, 5]
    np.testing.assert_array_equal(late.images[others], frames[2].images[others])
    for name in ("world_from_ego", "points_m", "lidar_range_m", "erp_range_m"):
        np.testing.assert_array_equal(getattr(late, name), getattr(frames[2], name))
    assert (late.range_m[2] != frames[2].range_m[2]).mean() > 0.1
    again = LateCamera(Scene("suburb", 4, RIG, **OPTIONS), 2, 0.2, 4).frame(2)
    np.testing.assert_array_equal(late.images, again.images)


def test_a_camera_can_be_late_in_the_first_frame():
    late = LateCamera(Scene("suburb", 4, RIG, **OPTIONS), 0, 0.2, 4).frame(0)
    assert late.time_s == 0
    assert late.images[0].any()
