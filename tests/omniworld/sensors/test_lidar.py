import numpy as np

from omniocc.metric import sparseocc_directions
from omniworld.sensors import lidar


def test_ego_rays_are_those_of_the_public_rayiou():
    rays = lidar.ego_directions()
    assert rays.dtype == np.float32
    np.testing.assert_allclose(rays, sparseocc_directions().numpy(), rtol=0, atol=1e-7)


def test_ego_scan_gives_range_and_class_of_known_surfaces(snapshot):
    ahead, down, up = [1, 0, 0], [0, 0, -1], [0, 0, 1]
    wall = np.array([0.6, -0.8, 0.0])
    range_m, labels = lidar.scan_ego(snapshot, np.array([ahead, down, up, wall], np.float32).T)
    np.testing.assert_allclose(range_m, [np.inf, 2.2, np.inf, 5 / 0.8], rtol=1e-6)
    assert labels.tolist() == [0, 1, 0, 5]
