import numpy as np

from omniworld.sensors import lidar


def test_ego_rays_are_those_of_the_public_rayiou():
    rays = lidar.ego_directions()
    assert rays.shape == (14040, 3)
    assert rays.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-6)
    pitch = np.degrees(np.arcsin(rays.reshape(39, 360, 3)[:, 0, 2]))
    expected = [-45.0, -26.565, -18.435, -14.036, -11.310, -9.462, -8.130, -7.125, -6.340, -5.711]
    np.testing.assert_allclose(pitch[:10], expected, atol=1e-3)
    np.testing.assert_allclose(np.diff(pitch[9:]), 0.6296, atol=1e-3)
    np.testing.assert_allclose(pitch[-1], 12.548, atol=1e-3)
    azimuth = np.degrees(np.arctan2(rays[:360, 1], rays[:360, 0])) % 360
    np.testing.assert_allclose(azimuth[:358], np.arange(358), atol=1e-4)


def test_ego_scan_gives_range_and_class_of_known_surfaces(snapshot):
    ahead, down, up = [1, 0, 0], [0, 0, -1], [0, 0, 1]
    wall = np.array([0.6, -0.8, 0.0])
    range_m, labels = lidar.scan_ego(snapshot, np.array([ahead, down, up, wall], np.float32).T)
    np.testing.assert_allclose(range_m, [np.inf, 2.2, np.inf, 5 / 0.8], rtol=1e-6)
    assert labels.tolist() == [0, 1, 0, 5]
