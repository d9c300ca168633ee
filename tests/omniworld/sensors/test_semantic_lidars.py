import numpy as np

from omniworld.mesh.mesh import concatenate, empty
from omniworld.sensors import thinning
from omniworld.sensors.semantic_lidars import LATTICE_M, SemanticLidars


def _lidars(snapshot, count=20) -> SemanticLidars:
    return SemanticLidars(snapshot.layers.casters[0], snapshot.surfaces, lambda x, y: 0 * x, count)


def test_points_lie_on_surfaces_of_their_class(snapshot):
    points, labels = _lidars(snapshot).scan(snapshot)
    assert points.dtype == np.float32
    assert labels.dtype == np.uint8
    road, wall, car = points[labels == 1], points[labels == 5], points[labels == 7]
    np.testing.assert_allclose(road[:, 2], -2.2, atol=1e-3)
    np.testing.assert_allclose(wall[:, 1], -5, atol=1e-3)
    assert (car > np.float32([7.99, 0.99, -2.01])).all()
    assert (car < np.float32([12.01, 2.81, -0.59])).all()
    assert set(np.unique(labels)) == {1, 3, 4, 5, 7, 9}
    assert np.abs(points[:, :2]).max() < thinning.REACH_M


def test_lidars_find_the_open_surface_of_the_street(snapshot):
    """Cells of 0.4 m that exact geometry occupies within 20 m: road, wall, and ground outside the house."""
    points, _ = _lidars(snapshot).scan(snapshot)
    found = {tuple(cell) for cell in np.floor(points[:, :2] / 0.4).astype(int)[points[:, 2] < -2.1]}
    x, y = np.meshgrid(np.arange(-50, 50), np.arange(-12, 50), indexing="ij")
    x_m, y_m = (x + 0.5) * 0.4, (y + 0.5) * 0.4
    expected = (np.hypot(x_m, y_m) < 20) & (y_m > -4.6) & ~((x_m > 7.5) & (x_m < 16.5) & (y_m > 0.8) & (y_m < 9.5))
    hit = np.array([(a, b) in found for a, b in zip(x[expected], y[expected], strict=True)])
    assert hit.mean() > 0.99


def test_near_the_axis_every_narrow_cell_gets_a_point(snapshot):
    points, _ = _lidars(snapshot).scan(snapshot)
    radius, azimuth = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    near = (radius < 2) & (points[:, 2] < -2)
    cells = np.zeros((10, 200), bool)
    cells[(radius[near] / 0.2).astype(int), ((azimuth[near] + np.pi) / (2 * np.pi) * 200).astype(int) % 200] = True
    assert cells.mean() > 0.99


def test_no_lidar_stands_inside_a_solid(snapshot_of, street, ego_car, noon, box):
    block = box([8, -4, 0], [28, 30, 12], 4)
    snapshot = snapshot_of(concatenate([street, block]), empty(), ego_car, noon)
    lidars = _lidars(snapshot)
    spots = np.array([lidars.position(cell) for cell in lidars.cells(snapshot.origin_m)])
    assert 15 <= len(spots) <= 19
    inside = (spots[:, 0] > 8) & (spots[:, 0] < 28) & (spots[:, 1] > -4) & (spots[:, 1] < 30)
    assert not inside.any()
    assert np.hypot(*spots[:, :2].T).max() < 21
    assert 1.59 < spots[:, 2].min() < spots[:, 2].max() < 4.81
    points, _ = lidars.scan(snapshot)
    deep = (
        (points[:, 0] > 8.05) & (points[:, 0] < 27.9) & (points[:, 1] > -3.9) & (points[:, 1] < 29) & (points[:, 2] < 9)
    )
    assert not deep.any()


def test_lidars_stay_at_their_positions_while_the_ego_moves(snapshot):
    lidars = _lidars(snapshot)
    here, ahead = lidars.cells(np.float32([0, 0, 2.2])), lidars.cells(np.float32([3, 0, 2.2]))
    assert len(set(here) & set(ahead)) > 12
    far = lidars.cells(np.float32([7 * LATTICE_M, 0, 2.2]))
    assert not set(here) & set(far)


def test_points_do_not_depend_on_earlier_frames(snapshot, snapshot_of, street, ego_car, noon, box):
    """Standing LiDARs keep static points; a car that left is gone, and one that came hides the points behind it."""
    lidars = _lidars(snapshot)
    first = lidars.scan(snapshot)
    empty_street = snapshot_of(street, empty(), ego_car, noon)
    lidars.scan(empty_street)
    again = lidars.scan(snapshot)
    fresh = _lidars(empty_street).scan(empty_street)
    for one, other in ((first, again), (fresh, lidars.scan(empty_street))):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    # The car is 0.2 m above the road: a few rays pass below it.
    below = (np.abs(fresh[0] - (10, 1.9, -2.2)) < (1.0, 0.3, 0.05)).all(axis=1)
    under_car = (np.abs(first[0] - (10, 1.9, -2.2)) < (1.0, 0.3, 0.05)).all(axis=1)
    assert below.sum() > 10 * under_car.sum()
    assert (first[1] == 7).sum() > 500
    assert not (fresh[1] == 7).any()


def test_fewer_lidars_see_less(snapshot):
    counts = [len(_lidars(snapshot, count).scan(snapshot)[0]) for count in (1, 5, 20)]
    assert counts[0] < counts[1] < counts[2]


def test_thinning_keeps_one_point_a_cube_and_prefers_thin_things():
    points = np.float32([[10.01, 0.01, 0.01], [10.02, 0.02, 0.02], [10.05, 0.05, 0.05], [10.15, 0, 0]])
    cube, scratch = thinning.cubes(points), np.zeros(thinning.SCRATCH, np.int32)
    assert thinning.first_of_each(cube, np.uint8([1, 11, 1, 1]), scratch).tolist() == [1, 3]
    assert thinning.first_of_each(cube, np.uint8([1, 1, 1, 1]), scratch).tolist() == [0, 3]


def test_thinning_against_a_dictionary():
    rng = np.random.default_rng(0)
    points = rng.uniform(-26, 26, (60000, 3)).astype(np.float32) * np.float32([1, 1, 0.1])
    points[30000:] = points[:30000] + rng.uniform(-0.02, 0.02, (30000, 3)).astype(np.float32)
    labels = rng.integers(1, 12, 60000).astype(np.uint8)
    kept = thinning.first_of_each(thinning.cubes(points), labels, np.zeros(thinning.SCRATCH, np.int32))
    best = {}
    for number, (cell, label) in enumerate(zip(map(tuple, np.floor(points * np.float32(10))), labels, strict=True)):
        if cell not in best or (label >= 9 and labels[best[cell]] < 9):
            best[cell] = number
    expected = set(best.values())
    assert expected <= set(kept.tolist())
    assert len(kept) < 1.02 * len(expected)  # cubes 25.6 m apart collide in the table
