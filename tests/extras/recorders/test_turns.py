"""Motion of the car within a turn of the LiDAR, against points whose place in the world is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omniocc.data.formats.clouds import RawCloud
from omniocc.errors import DataError
from omniocc.extras.recorders.files import scans_of
from omniocc.extras.recorders.labels import read_point_classes
from omniocc.extras.recorders.turns import are_after, at_one_time, seconds_of

RNG = np.random.default_rng(3)
SCAN_S = 1_700_000_000.25
AFTER_S = np.linspace(0.0, 0.099, 500)
"""Times of points after the stamp of their scan."""


def pose_at(time_s):
    """Return the pose of a car that drives a circle: 15 m/s, 40 degrees a second."""
    turn, radius_m = np.deg2rad(40) * time_s, 15 / np.deg2rad(40)
    pose = np.broadcast_to(np.eye(4), (len(turn), 4, 4)).copy()
    pose[:, :3, :3] = Rotation.from_euler("z", turn[:, None]).as_matrix()
    pose[:, :3, 3] = radius_m * np.stack([np.sin(turn), 1 - np.cos(turn), 0 * turn], 1)
    return pose


def test_points_of_a_turn_are_where_they_stand_in_the_world():
    world_m = RNG.uniform([-20, -20, -2], [20, 20, 3], (len(AFTER_S), 3))
    measured = np.linalg.inv(pose_at(AFTER_S))
    measured_m = np.einsum("pij,pj->pi", measured[:, :3, :3], world_m) + measured[:, :3, 3]
    (frame,) = pose_at(np.array([0.04]))
    there = np.linalg.inv(frame)
    expected_m = world_m @ there[:3, :3].T + there[:3, 3]
    pose_times_s = np.arange(-0.1, 0.06, 0.01)  # the turn ends after the last pose
    points_m = measured_m.astype(np.float32)
    found_m = at_one_time(points_m, SCAN_S + AFTER_S, SCAN_S + pose_times_s, pose_at(pose_times_s), frame)
    wrong_m = np.linalg.norm(found_m - expected_m, axis=1)
    assert wrong_m[AFTER_S < 0.05].max() < 0.005
    assert wrong_m.max() < 0.02  # beyond the last pose the motion goes straight on
    assert np.linalg.norm(points_m - expected_m, axis=1).max() > 1.0  # without the correction


@pytest.mark.parametrize(
    "times",
    [
        AFTER_S.astype(np.float32),  # of Velodyne
        AFTER_S - 0.099,  # before the stamp of the scan
        (AFTER_S * 1e3).astype(np.float32),
        (AFTER_S * 1e6).astype(np.uint32),
        (AFTER_S * 1e9).astype(np.uint32),  # of Ouster and Livox
        SCAN_S + AFTER_S,  # of Hesai and RoboSense
        ((SCAN_S + AFTER_S) * 1e9).astype(np.uint64),
    ],
)
def test_the_unit_of_times_is_found(times):
    late_s = AFTER_S - (0.099 if times[0] < 0 else 0.0)
    np.testing.assert_allclose(seconds_of(times, SCAN_S, "here") - SCAN_S, late_s, atol=2e-6)


def test_a_clock_that_begins_at_zero():
    np.testing.assert_allclose(seconds_of(0.3 + AFTER_S, 0.3, "here"), 0.3 + AFTER_S)
    np.testing.assert_allclose(seconds_of(AFTER_S, 0.3, "here"), 0.3 + AFTER_S)


def test_a_late_scan_tells_from_where_times_count():
    """At a stamp of .1 s times up to .1 s may be after it or by the clock; at 2 s they may not."""
    assert are_after(AFTER_S, 2.0) is are_after((AFTER_S * 1e9).astype(np.uint32), 2.0) is True
    assert are_after(2.0 + AFTER_S, 2.0) is False
    assert are_after(None, 2.0) is are_after(np.zeros(0), 2.0) is are_after(AFTER_S * 15, 2.0) is None
    np.testing.assert_allclose(seconds_of(AFTER_S, 0.1, "here", after=True), 0.1 + AFTER_S)
    np.testing.assert_allclose(seconds_of(0.1 + AFTER_S, 0.1, "here", after=False), 0.1 + AFTER_S)


def test_the_last_scan_tells_for_the_first_ones():
    options, none = {"own_car_m": None, "deskew": True}, read_point_classes(None)
    points, stamps_s = np.ones((len(AFTER_S), 3), np.float32), np.array([0.1, 5.0])
    for is_after in (True, False):
        times = [AFTER_S if is_after else stamp_s + AFTER_S for stamp_s in stamps_s]
        clouds = [RawCloud(points, None, one) for one in times]
        scans = scans_of(stamps_s, clouds.__getitem__, "scan {}".format, np.eye(4), none, options)
        for number, stamp_s in enumerate(stamps_s):
            np.testing.assert_allclose(scans.read(number).times_s, stamp_s + AFTER_S)


def test_points_of_one_time_need_no_correction():
    assert seconds_of(np.full(9, 7, np.uint32), SCAN_S, "here") is None
    assert seconds_of(np.zeros(0), SCAN_S, "here") is None


@pytest.mark.parametrize("times", [AFTER_S * 15, SCAN_S + 60 + AFTER_S, np.array([0.0, np.nan])])
def test_times_of_no_turn_are_refused(times):
    with pytest.raises(DataError, match=r"^cloud 7: the times .*; lidar.deskew=false reads the points without them$"):
        seconds_of(times, SCAN_S, "cloud 7")
