import numpy as np

from omniocc.world import lidar
from omniocc.world.mesh import concatenate, empty


def test_ego_rays_are_rayious():
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


def test_ego_scan_gives_range_and_class_of_known_surfaces(stage):
    ahead, down, up = [1, 0, 0], [0, 0, -1], [0, 0, 1]
    wall = np.array([0.6, -0.8, 0.0])
    range_m, labels = lidar.scan_ego(stage, np.array([ahead, down, up, wall], np.float32).T)
    np.testing.assert_allclose(range_m, [np.inf, 2.2, np.inf, 5 / 0.8], rtol=1e-6)
    assert labels.tolist() == [0, 1, 0, 5]


def test_points_lie_on_surfaces_of_their_class(stage):
    points, labels = lidar.scan_surfaces(stage, lidar.virtual_lidars())
    assert points.dtype == np.float32
    assert labels.dtype == np.uint8
    road, wall, car = points[labels == 1], points[labels == 5], points[labels == 7]
    np.testing.assert_allclose(road[:, 2], -2.2, atol=1e-3)
    np.testing.assert_allclose(wall[:, 1], -5, atol=1e-3)
    assert (car > np.float32([7.99, 0.99, -2.01])).all()
    assert (car < np.float32([12.01, 2.81, -0.59])).all()
    assert set(np.unique(labels)) == {1, 3, 4, 5, 7, 9}
    assert np.abs(points[:, :2]).max() < lidar.REACH_M


def test_lidars_find_the_open_surface_of_the_street(stage):
    """Cells of 0.4 m that exact geometry occupies within 20 m: road, wall, and ground outside the house."""
    points, _ = lidar.scan_surfaces(stage, lidar.virtual_lidars())
    found = {tuple(cell) for cell in np.floor(points[:, :2] / 0.4).astype(int)[points[:, 2] < -2.1]}
    x, y = np.meshgrid(np.arange(-50, 50), np.arange(-12, 50), indexing="ij")
    x_m, y_m = (x + 0.5) * 0.4, (y + 0.5) * 0.4
    want = (np.hypot(x_m, y_m) < 20) & (y_m > -4.6) & ~((x_m > 7.5) & (x_m < 16.5) & (y_m > 0.8) & (y_m < 9.5))
    hit = np.array([(a, b) in found for a, b in zip(x[want], y[want], strict=True)])
    assert hit.mean() > 0.99


def test_near_the_axis_every_narrow_cell_gets_a_point(stage):
    points, _ = lidar.scan_surfaces(stage, lidar.virtual_lidars())
    radius, azimuth = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    near = (radius < 2) & (points[:, 2] < -2)
    cells = np.zeros((10, 200), bool)
    cells[(radius[near] / 0.2).astype(int), ((azimuth[near] + np.pi) / (2 * np.pi) * 200).astype(int) % 200] = True
    assert cells.mean() > 0.99


def test_no_lidar_stands_inside_a_solid(stage_of, street, own_car, noon, box):
    block = box([8, -4, 0], [28, 30, 12], 4)
    stage = stage_of(concatenate([street, block]), empty(), own_car, noon)
    spots = lidar.choose_spots(stage, lidar.virtual_lidars())
    assert len(spots) == 19
    inside = (spots[:, 0] > 8) & (spots[:, 0] < 28) & (spots[:, 1] > -4)
    assert not inside.any()
    assert np.abs(spots[:, :2]).max() <= 20
    assert 1 < (spots[:, 2] + 2.2).min() < (spots[:, 2] + 2.2).max() < 5
    points, _ = lidar.scan_surfaces(stage, lidar.virtual_lidars())
    deep = (
        (points[:, 0] > 8.05) & (points[:, 0] < 27.9) & (points[:, 1] > -3.9) & (points[:, 1] < 29) & (points[:, 2] < 9)
    )
    assert not deep.any()


def test_thinning_keeps_one_point_a_cube_and_prefers_thin_things():
    points = np.float32(
        [[10.01, 0.01, 0.01], [10.02, 0.02, 0.02], [10.05, 0.05, 0.05], [10.15, 0, 0], [1, 1, 0], [1, 1.001, 0]]
    )
    labels = np.uint8([1, 11, 1, 1, 1, 1])
    assert lidar._thin_out(points, labels).tolist() == [False, True, False, True, True, True]
    assert lidar._thin_out(points, np.full(6, 1, np.uint8)).tolist() == [True, False, False, True, True, True]
