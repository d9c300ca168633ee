"""Recorded panoramas at other sizes."""

import dataclasses

import numpy as np
import pytest
import torch
from fake_scene import FakeWorld, fake_frame

from omniocc.camera import Equirectangular
from omniocc.data.dataset import WindowDataset, collate
from omniocc.data.formats.projected import onto_panorama
from omniocc.data.store.reader import hits_of_moving, resampled
from omniocc.frame import Box
from omniocc.geometry import Cylinder

FINE, COARSE = Equirectangular(720, 180, 45.0, -45.0), Equirectangular(192, 48, 45.0, -45.0)
CAR = Box(1, 7, (10.0, 0.0, -1.4), (4.0, 2.0, 1.6), 0.0, (8.0, 0.0))


def ranges_of(panorama: Equirectangular) -> np.ndarray:
    """Return the ranges of a box of 20 x 12 x 8 m around the origin, exactly."""
    rays = panorama.rays()
    return (torch.tensor([10.0, 6.0, 4.0]) / rays.abs()).amin(dim=-1).numpy()


def test_ranges_are_those_of_the_same_directions():
    for given, wanted in ((FINE, COARSE), (COARSE, FINE)):
        found, true = resampled(ranges_of(given), given, wanted), ranges_of(wanted)
        assert found.shape == (wanted.height, wanted.width)
        step = np.radians(90 / min(given.height, wanted.height))
        assert np.median(np.abs(found / true - 1)) < step
        assert np.abs(found / true - 1).max() < 6 * step  # where a wall is seen at its flattest
    assert resampled(ranges_of(FINE), FINE, FINE) is not None


def test_beyond_the_recorded_edges_nothing_is_known():
    narrow = Equirectangular(720, 120, 15.0, -45.0)
    found = resampled(ranges_of(narrow), narrow, COARSE)
    assert np.isnan(found[:16]).all()  # 45 to 15 degrees: 30 of 90 degrees, 16 of 48 rows
    assert np.isfinite(found[16:]).all()


def test_no_point_of_a_lidar_is_lost():
    directions = np.random.default_rng(0).normal(size=(300, 3)) * (1, 1, 0.3)
    points = 8 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    found = resampled(onto_panorama(points, None, FINE).range_m, FINE, COARSE)
    direct = onto_panorama(points, None, COARSE).range_m
    near = torch.from_numpy(np.isfinite(found)).float()[None, None]
    near = torch.nn.functional.max_pool2d(near, 3, 1, padding=1)[0, 0].numpy()  # a fine pixel may lie in the next cell
    assert near[:, 1:-1][np.isfinite(direct)[:, 1:-1]].all()
    assert abs(np.isfinite(found).sum() / np.isfinite(direct).sum() - 1) < 0.03
    assert np.allclose(found[np.isfinite(found)], 8)


def rays(*points_m) -> tuple[np.ndarray, np.ndarray]:
    """Return ranges and directions of these points."""
    points = np.array(points_m, dtype=np.float32)
    range_m = np.linalg.norm(points, axis=1)
    return range_m, points / range_m[:, None]


def moved(box: Box, *points_m, label: int = 7) -> list[bool]:
    range_m, directions = rays(*points_m)
    labels = np.full(len(range_m), label, dtype=np.uint8)
    return hits_of_moving(range_m, labels, directions, [box]).tolist()


def test_hits_in_the_box_of_a_moving_actor_move():
    assert moved(CAR, (8.1, 0.9, -1), (11.9, -0.9, -1), (7.6, 0, -1), (10, 1.4, -1)) == [True, True, False, False]


def test_hits_without_a_class_move_with_the_actor_in_whose_box_they_are():
    assert moved(CAR, (8.1, 0.9, -1), (7.6, 0, -1), label=255) == [True, False]
    assert moved(CAR, (8.1, 0.9, -1), label=3) == [False]


def test_a_hit_may_lie_a_little_outside_of_the_box():
    """Of the car's 4 m half are 2 m, and .3 m more."""
    assert moved(CAR, (12.29, 0, -1), (12.31, 0, -1)) == [True, False]


@pytest.mark.parametrize(
    ("velocity", "moves"),
    [((-8.0, 0.0), True), ((0.0, 1.4), True), ((0.0, -0.31), True), ((0.31, 0.0), True), ((0.2, -0.2), False)],
)
def test_what_is_faster_than_a_creep_in_any_direction_moves(velocity, moves):
    assert moved(dataclasses.replace(CAR, velocity_mps=velocity), (10, 0, -1)) == [moves]


def test_the_box_is_turned_with_the_actor():
    """Turned by 90 degrees, the car is 2 m long along x and 4 m along y."""
    turned = CAR.__class__(**{**vars(CAR), "yaw_rad": np.pi / 2})
    assert moved(turned, (8.1, 0.9, -1), (10, 1.9, -1), (10.9, -1.9, -1)) == [False, True, True]
    oblique = CAR.__class__(**{**vars(CAR), "yaw_rad": np.pi / 4})
    end = 1.9 / np.sqrt(2)  # along the diagonal
    assert moved(oblique, (10 + end, end, -1), (10 + end, -end, -1)) == [True, False]


def test_other_classes_and_actors_that_stand_do_not_move():
    assert moved(CAR, (10, 0, -1), label=6) == [False]
    assert moved(CAR.__class__(**{**vars(CAR), "velocity_mps": (0.1, 0.1)}), (10, 0, -1)) == [False]


def test_rays_without_a_hit_do_not_move():
    range_m, directions = rays((10, 0, -1), (10, 0, -1))
    range_m[1] = np.inf
    labels = np.array([7, 0], dtype=np.uint8)
    assert hits_of_moving(range_m, labels, directions, [CAR]).tolist() == [True, False]
    assert hits_of_moving(range_m, labels, directions, []).tolist() == [False, False]


def test_scenes_of_the_world_tell_what_moves_and_where_it_was_recorded(tmp_path):
    world = FakeWorld(str(tmp_path))
    world.prepare()
    scene, plan = world.scenes("test")[0], next(plan for plan in world.plans if plan.split == "test")
    assert scene.conditions == {"weather": world.weather_of(plan), "place": plan.theme}
    frame, scan = fake_frame(plan.seed, 1), scene.lidar(1)
    assert scan is not None
    moving = hits_of_moving(scan.range_m, scan.labels, scan.directions, frame.boxes)
    assert np.array_equal(scan.moving, moving)
    dataset = WindowDataset([scene], world.labels(Cylinder((8, 12, 4)), "none"), 1)
    world.labels(Cylinder((8, 12, 4)), "none").prepare([scene])
    batch = collate([dataset[1], dataset[2]])
    assert batch.lidar_moving is not None
    assert np.array_equal(batch.lidar_moving[0].numpy(), moving)
