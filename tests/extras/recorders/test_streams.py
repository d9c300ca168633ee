"""Time stamps and poses between them, against brute force and scipy's slerp."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from omniocc.extras.recorders.streams import MISSING, gap_s, interpolate, lacking, nearest, paced

RNG = np.random.default_rng(1)


def poses_of(count):
    poses = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    poses[:, :3, :3] = Rotation.random(count, random_state=2).as_matrix()
    poses[:, :3, 3] = RNG.uniform(-1e6, 1e6, (count, 3))
    return poses


def test_nearest_is_that_of_brute_force():
    times_s = np.sort(RNG.uniform(0, 10, 60))
    at_s = RNG.uniform(-1, 11, 200)
    found = nearest(times_s, at_s, 0.1)
    gaps = np.abs(times_s[None] - at_s[:, None])
    expected = np.where(gaps.min(1) <= 0.1, gaps.argmin(1), MISSING)
    assert np.array_equal(found, expected)
    assert (found == MISSING).any()
    assert gap_s(times_s, at_s) == gaps.min()
    assert nearest(np.array([]), at_s, 1.0).tolist() == [MISSING] * 200


def test_frames_at_an_interval():
    times_s = 100 + np.array([0.0, 0.1, 0.2, 0.3, 0.41, 0.49, 1.2, 1.3])
    assert paced(times_s, None).tolist() == list(range(8))
    assert paced(times_s, 0.2).tolist() == [0, 2, 4, 6]  # none for .6, .8 and 1.0
    assert paced(times_s, 10.0).tolist() == [0]
    tenths = np.arange(11) / 10
    assert paced(tenths[:9], 0.5).tolist() == [0, 5], ".8 does not stand in for 1.0"
    tenths[10] = 0.98
    assert paced(tenths, 0.5).tolist() == [0, 5, 10]


def test_lacking_names_the_streams():
    matches = {"front": np.array([0, MISSING]), "lidar": np.array([MISSING, MISSING])}
    assert lacking(matches) == [["lidar"], ["front", "lidar"]]


def test_interpolation_is_slerp_and_straight():
    times_s, poses = 1.7e9 + np.cumsum(RNG.uniform(0.1, 1, 20)), poses_of(20)
    at_s = np.sort(RNG.uniform(times_s[0], times_s[-1], 300))
    found, known = interpolate(times_s, poses, at_s, 0.0)
    assert known.all()
    expected = Slerp(times_s, Rotation.from_matrix(poses[:, :3, :3]))(at_s).as_matrix()
    assert np.abs(found[:, :3, :3] - expected).max() < 1e-7
    for axis in range(3):
        line = np.interp(at_s, times_s, poses[:, axis, 3])
        np.testing.assert_allclose(found[:, axis, 3], line, rtol=0, atol=1e-3)  # of 1e6 m, at stamps exact to 1e-7 s


def test_poses_at_their_own_times_stay_as_they_are():
    times_s, poses = np.arange(5.0), poses_of(5)
    found, known = interpolate(times_s, poses, times_s, 0.1, most_s=0.5)
    assert known.all()
    assert np.array_equal(found, poses)


def test_ends_and_gaps():
    times_s = np.array([0.0, 1.0, 5.0, 6.0])
    poses = np.broadcast_to(np.eye(4), (4, 4, 4)).copy()
    poses[:, 0, 3] = 10 * times_s
    at_s = np.array([-0.2, -0.05, 0.5, 3.0, 6.05, 6.2])
    found, known = interpolate(times_s, poses, at_s, 0.1, most_s=2.0)
    assert known.tolist() == [False, True, True, False, True, False]
    np.testing.assert_allclose(found[known, 0, 3], 10 * at_s[known])  # at constant speed beyond the ends
    one, known = interpolate(times_s[:1], poses[:1], np.array([0.05, 1.0]), 0.1)
    assert known.tolist() == [True, False]
    assert np.array_equal(one[0], poses[0])


@pytest.mark.parametrize("count", [0, 3])
def test_no_poses_no_frames(count):
    found, known = interpolate(np.zeros(0), np.zeros((0, 4, 4)), np.arange(float(count)), 1.0)
    assert len(found) == count
    assert not known.any()
