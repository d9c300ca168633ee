"""Rays of a frame and its neighbours: brought over by pose, and without what has moved."""

import math

import numpy as np
import pytest
import torch

from omniocc.data.dataset import Needs, WindowDataset, collate
from omniocc.data.formats.poses import inverse, transform_points
from omniocc.data.rays import FAR_M, in_front, rays_around
from omniocc.data.source import LidarScan
from omniocc.errors import UserError
from omniocc.loss import RayWindow

SPHERE_M = 12.0
CAR = 7


class Scene:
    """A round wall of 12 m about the origin of the world, and a car that stands in it at a place of its own a frame."""

    name = "made"

    def __init__(self, positions, cars_m, known=False, unseen=()):
        self.world_from_ego = np.stack([pose(*at) for at in positions])
        self.cars_m, self.known, self.unseen = cars_m, known, unseen

    def __len__(self):
        return len(self.cars_m)

    def lidar(self, frame):
        if frame in self.unseen:
            return None
        directions = around()
        position, turn = self.world_from_ego[frame, :3, 3], self.world_from_ego[frame, :3, :3]
        ways = directions @ turn.T
        along = ways @ position
        range_m = -along + np.sqrt(along**2 + SPHERE_M**2 - position @ position)
        car_m = range_to_ball(position, ways, np.array(self.cars_m[frame]))
        hit = car_m < range_m
        labels = np.where(hit, CAR, 4).astype(np.uint8)
        range_m = np.minimum(range_m, car_m).astype(np.float32)
        return LidarScan(range_m, labels, directions.astype(np.float32), moving=hit if self.known else None)


def pose(x_m, y_m, yaw):
    matrix = np.eye(4)
    matrix[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    matrix[:3, 3] = x_m, y_m, 0
    return matrix


def around():
    azimuth, elevation = np.meshgrid(np.radians(np.arange(360)), np.radians(np.arange(-20, 21)))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)


def range_to_ball(position, ways, middle, radius_m=1.5):
    """Return the distance along unit ways at which a ball is hit; inf beside it."""
    away = position - middle
    along = ways @ away
    inside = along**2 - away @ away + radius_m**2
    return np.where((inside > 0) & (along < 0), -along - np.sqrt(np.maximum(inside, 0)), np.inf)


AWAY = (0.0, 0.0, 500.0)


def test_rays_of_another_frame_end_where_their_points_are():
    scene = Scene([(0, 0, 0), (2, -1, 0.7)], [AWAY, AWAY])
    rays = rays_around(scene, 1, RayWindow([0, -1], True))
    count = len(around())
    assert rays.labels.shape == (1, 2 * count)
    own, other = rays.ends_m[0, :count].numpy(), rays.ends_m[0, count:].numpy()
    assert not rays.origins_m[0, :count].any()
    before = inverse(scene.world_from_ego[1])[:3, 3]  # of the origin of the world, where the ego was
    np.testing.assert_allclose(rays.origins_m[0, count:], np.broadcast_to(before, other.shape), atol=1e-5)
    for ends in (own, other):  # all lie on the same wall
        world = transform_points(scene.world_from_ego[1], ends)
        np.testing.assert_allclose(np.linalg.norm(world, axis=1), SPHERE_M, rtol=1e-5)


def test_a_shifted_car_gives_the_same_rays():
    here, there = ([(x + at, y, yaw) for at in (0, 1.5)] for x, y, yaw in ((0, 0, 0), (0, 0, 0)))
    moved = Scene(there, [AWAY] * 2)
    moved.world_from_ego = pose(40, 30, 2.0) @ moved.world_from_ego
    straight = Scene(here, [AWAY] * 2)
    moved.lidar = straight.lidar  # the same scans in another place of the world
    one, other = (rays_around(scene, 0, RayWindow([0, 1], True)) for scene in (straight, moved))
    for mine, theirs in zip(one, other, strict=True):
        torch.testing.assert_close(mine.float(), theirs.float(), atol=1e-4, rtol=0)


@pytest.mark.parametrize("known", [True, False], ids=["boxes", "consistency"])
def test_points_that_moved_stay_in_their_own_frame(known):
    scene = Scene([(0, 0, 0), (0.5, 0, 0), (1, 0, 0)], [(7.0, -4, 0), (7.0, 0, 0), (7.0, 4, 0)], known)
    alone, window = (rays_around(scene, 1, RayWindow(frames, True)) for frames in ([0], [-1, 0, 1]))
    cars = window.ends_m[0][window.labels[0] == CAR]
    seen = alone.ends_m[0][alone.labels[0] == CAR]
    assert len(seen) > 100
    others = cars[len(seen) :]
    assert torch.equal(cars[: len(seen)], seen), "those of its own frame are all there"
    moved = sum(int((scene.lidar(frame).labels == CAR).sum()) for frame in (0, 2))
    assert len(others) < (1 if known else 0.05 * moved)
    walls, total = int((window.labels == 4).sum()), sum(int((scene.lidar(k).labels == 4).sum()) for k in range(3))
    assert walls == total if known else walls > 0.97 * total


def test_what_stands_is_kept_by_consistency():
    scene = Scene([(0, 0, 0), (1, 0, 0.3)], [(7.0, 2, 0)] * 2)
    rays = rays_around(scene, 0, RayWindow([0, 1], True))
    total = sum(int((scene.lidar(frame).labels == CAR).sum()) for frame in range(2))
    assert int((rays.labels == CAR).sum()) > 0.99 * total


def test_points_in_directions_without_rays_are_kept():
    scan = Scene([(0, 0, 0)], [AWAY]).lidar(0)
    up, ahead = np.array([[0.0, 0, 5]], np.float32), np.array([[5.0, 0, 0], [11.5, 0, 0]], np.float32)
    assert not in_front(up, scan).any()
    assert in_front(ahead, scan).tolist() == [True, False]


def test_rays_of_other_frames_need_poses():
    scene = Scene([(0, 0, 0)] * 2, [AWAY] * 2)
    scene.has_poses = False
    assert rays_around(scene, 0, RayWindow([0], True)) is not None
    with pytest.raises(UserError, match=r"^loss\.rays\.frames=\[-1, 0\]: 'made' has no poses .*frames=\[0\]$"):
        rays_around(scene, 0, RayWindow([-1, 0], True))


def test_frames_that_are_missing_are_left_out():
    scene = Scene([(0, 0, 0)] * 3, [AWAY] * 3, unseen=[1])
    window = RayWindow([-2, -1, 0, 1, 2], True)
    count = len(around())
    assert [rays_around(scene, frame, window).labels.shape[1] for frame in (0, 2)] == [2 * count] * 2
    assert rays_around(scene, 1, window) is None, "a frame needs a scan of its own"


def test_rays_without_a_return_are_free_and_others_occupied_of_no_class():
    scene = Scene([(0, 0, 0)], [AWAY])
    scan = scene.lidar(0)
    scan.range_m[:4] = np.inf, np.inf, 0, np.nan
    scan.labels[:4] = 0, 255, 4, 4  # only the first measured that nothing is there
    scan.labels[4] = 255
    scene.lidar = lambda frame: scan
    rays = rays_around(scene, 0, RayWindow([0], True))
    assert rays.labels[0, :3].tolist() == [0, 255, 4]
    assert len(rays.labels[0]) == len(around()) - 3
    assert float(rays.ends_m[0, 0].norm()) == pytest.approx(FAR_M, rel=1e-5)
    without = rays_around(scene, 0, RayWindow([0], False))
    assert without.labels.unique().tolist() == [0, 255]
    assert torch.equal(without.labels == 0, rays.labels == 0)


def test_samples_hold_rays_where_they_are_asked_for_and_batches_pad_them(fake_world):
    scenes = fake_world.scenes("train")
    dataset = WindowDataset(scenes, None, 1, Needs(voxels=False, scores=False, rays=RayWindow([-1, 0, 1], True)))
    samples = [dataset[0], dataset[1]]
    expected = rays_around(scenes[0], 1, RayWindow([-1, 0, 1], True))
    assert torch.equal(samples[1].scan_ends, expected.ends_m[0])
    batch = collate(samples)
    first, second = (len(sample.scan_labels) for sample in samples)
    assert first < second == batch.scan_labels.shape[1], "the first frame has no frame before"
    assert batch.scan_origins[0, first:].isnan().all()
    assert batch.scan_origins[0, :first].isfinite().all()
    dataset.needs = Needs(voxels=False, scores=False)
    assert dataset[0].scan_ends is None


@pytest.fixture
def fake_world(tmp_path):
    from fake_scene import FakeWorld

    world = FakeWorld(tmp_path)
    world.prepare()
    return world
