import numpy as np
import torch

from omniocc.geometry import Cylinder
from omniworld.mesh.mesh import concatenate, empty
from omniworld.sensors.geometry_labels import GeometryLabels, cut, spread
from omniworld.sensors.lidar import inner_rays, scan_ego


def test_points_fill_a_triangle_evenly():
    corner = np.array([[[0, 0, 1], [4, 0, 1], [0, 3, 1]]], np.float32) + np.array([20, 0, 0], np.float32)
    points, normal, triangle = spread(corner)
    points = points - np.array([20, 0, 0], np.float32)
    assert len(points) == 480  # 6 m2 at 80 points per m2
    assert (triangle == 0).all()
    np.testing.assert_allclose(normal, [[0, 0, 1]], atol=1e-6)
    assert (points[:, :2] >= -1e-5).all()
    assert (points[:, 0] / 4 + points[:, 1] / 3 <= 1 + 1e-5).all()
    cells = np.floor(points[:, :2] / 0.5).astype(int)
    inside = {(a, b) for a in range(8) for b in range(6) if (a + 1) / 8 + (b + 1) / 6 <= 1}
    counts = [np.count_nonzero((cells == cell).all(axis=1)) for cell in sorted(inside)]
    assert min(counts) >= 16  # 20 on average
    assert max(counts) <= 24


def test_every_small_triangle_gets_a_point():
    corner = np.random.default_rng(0).uniform(9, 9.02, (100, 3, 3)).astype(np.float32)
    assert np.array_equal(np.unique(spread(corner)[2]), np.arange(100))


def test_cutting_keeps_the_area_within_reach_and_drops_the_rest():
    huge = np.array(
        [[[-300, -300, 0], [300, -300, 0], [0, 500, 0]], [[100, 100, 0], [101, 100, 0], [100, 101, 0]]], np.float32
    )
    pieces, number = cut(huge, 10.0)
    assert (number == 0).all()
    area = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    assert area.max() <= 2.0
    assert 400 <= area.sum() < 650
    distance = np.hypot(*pieces[..., :2].mean(axis=1).T)
    assert (area <= 0.1 * np.maximum(distance, 0.06) ** 2 + 1e-6).all()


def test_points_near_the_ego_fill_the_cells_that_rays_reach(snapshot, street):
    """The innermost cells of the paper's cylinder are 3 mm wide."""
    grid = Cylinder()
    rays = inner_rays()
    range_m, _ = scan_ego(snapshot, rays)
    ends = (rays * range_m).T[np.isfinite(range_m)]
    ends = torch.from_numpy(np.ascontiguousarray(ends[np.hypot(*ends[:, :2].T) < 4]))
    cells, inside = grid.flat_index(ends)
    points, labels = GeometryLabels(street).scan(snapshot)
    voxels = grid.voxelize(torch.from_numpy(points), torch.from_numpy(labels)).flatten()
    hit = torch.unique(cells[inside])
    assert len(hit) > 3900  # 20 rings of 200
    for ring in range(4):
        cell = hit[hit // (200 * 16) // 5 == ring]
        filled = (voxels[cell] > 0).float().mean()
        assert filled > 0.97, (ring, filled)


def test_hidden_surfaces_get_points_and_covered_ones_do_not(snapshot_of, street, ego_car, noon, box, quad):
    line = quad([[-5, 1, 0.005], [5, 1, 0.005], [5, 1.3, 0.005], [-5, 1.3, 0.005]], 11)
    static = concatenate([street, line])
    snapshot = snapshot_of(static, box([8, 1, 0.2], [12, 2.8, 1.6], 7), ego_car, noon)
    points, labels = GeometryLabels(static).scan(snapshot)
    assert points.dtype == np.float32
    assert labels.dtype == np.uint8
    under = (labels == 7) & (np.abs(points[:, 2] + 2.0) < 1e-3)
    assert under.sum() > 200  # the car's underside
    roof = (labels == 4) & (np.abs(points[:, 2] - 3.8) < 1e-3)
    assert roof.sum() > 500
    on_line = (np.abs(points[:, 0]) < 4.9) & (points[:, 1] > 1.02) & (points[:, 1] < 1.28) & (points[:, 2] < -2.1)
    assert (labels[on_line] == 11).all()
    assert on_line.sum() > 100
    assert np.abs(points[:, :2]).max() <= 26


def test_the_same_points_every_time(snapshot, street):
    first, again = (GeometryLabels(street).scan(snapshot) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


def test_an_empty_world_has_no_points(snapshot_of, ego_car, noon):
    snapshot = snapshot_of(empty(), empty(), ego_car, noon)
    points, labels = GeometryLabels(empty()).scan(snapshot)
    assert points.shape == (0, 3)
    assert labels.shape == (0,)
