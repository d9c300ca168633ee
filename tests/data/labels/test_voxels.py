import fake_scene
import numpy as np
import pytest
import torch
from fake_scene import FakeWorld, fake_frame
from fake_source import FakeFrames

from omniocc.data.labels import voxels as observed
from omniocc.data.labels.voxels import VoxelCache, vote
from omniocc.data.source import LidarScan, Points
from omniocc.data.store import codec, reader
from omniocc.geometry import Cuboid, Cylinder

GRIDS = [
    Cylinder(shape=(16, 20, 8), radius_m=(0.0, 25.6), height_m=(-2.8, 3.6)),
    Cuboid(shape=(18, 14, 8), x_m=(-25.6, 25.6), y_m=(-25.6, 25.6), height_m=(-2.8, 3.6)),
]


@pytest.fixture
def scene(tmp_path, monkeypatch):
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False) + 0.01
    rays = np.stack([np.cos(angles), np.sin(angles), 0.1 * np.cos(7 * angles)], axis=1)
    rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    monkeypatch.setattr(reader, "_lidar_directions", lambda: rays)
    monkeypatch.setattr(fake_scene, "RAYS", len(rays))
    world = FakeWorld(tmp_path, scenes=(1, 0, 0))
    world.prepare()
    return world.scenes("train")[0]


def walked(geometry, origins, directions, range_m):
    """Cells left before the range, in steps of 2 mm in float64: surely left, and left with a tolerance at the end."""
    sure, maybe = np.zeros(geometry.num_cells, bool), np.zeros(geometry.num_cells, bool)
    for origin, direction, limit_m in zip(origins, directions, range_m, strict=True):
        if np.isnan(limit_m):
            continue
        distance_m = np.arange(0.001, min(limit_m + 0.02, 60.0), 0.002)
        cells, inside = geometry.flat_index(torch.from_numpy(origin + distance_m[:, None] * direction))
        cells, inside = cells.numpy(), inside.numpy()
        leaves = np.flatnonzero((cells[1:] != cells[:-1]) | (inside[1:] != inside[:-1]))
        left = leaves[inside[leaves]]
        sure[cells[left[distance_m[left] < limit_m - 0.02]]] = True
        maybe[cells[left]] = True
    return sure, maybe


@pytest.mark.parametrize("geometry", GRIDS, ids=["cylinder", "cuboid"])
def test_seen_are_the_cells_that_rays_leave_before_they_hit(scene, geometry):
    rig, frame = scene.rig, fake_frame(0, 1)
    origins, directions = [np.zeros((64, 3))], [scene.lidar(1).directions.astype(np.float64)]
    ranges = [frame.lidar_range_m]
    for k in range(6):
        rays, valid = rig.rays(k)
        rays = rays[2::4, 2::4].reshape(-1, 3).double().numpy()
        origins.append(np.tile(rig.ego_from_camera[k, :3, 3].numpy(), (len(rays), 1)))
        directions.append(rays)
        ranges.append(np.where(valid.numpy(), frame.range_m[k], np.nan)[2::4, 2::4].ravel())
    sure, maybe = walked(geometry, np.concatenate(origins), np.concatenate(directions), np.concatenate(ranges))
    points_m, _ = codec.decode_points(codec.encode_points(frame.points_m, frame.point_labels))
    cells, inside = geometry.flat_index(torch.from_numpy(points_m))
    sure[cells[inside]] = maybe[cells[inside]] = True
    mask = observed.observed(scene, 1, geometry)
    assert mask.dtype == torch.uint8
    assert mask.shape == geometry.shape
    seen = mask.flatten().numpy() == 1
    assert 0.05 < seen.mean() < 0.95
    assert not np.any(seen & ~maybe)
    assert not np.any(sure & ~seen)


def test_unobserved_cells_are_unknown_and_kept_apart(scene, tmp_path):
    caches = {name: VoxelCache(tmp_path / "cache", GRIDS[0], name) for name in ("none", "unobserved")}
    for cache in caches.values():
        cache.prepare([scene])
    assert caches["none"].folder != caches["unobserved"].folder
    free, strict = (cache.read(scene, 2) for cache in caches.values())
    assert torch.equal(free, vote(scene, 2, GRIDS[0]))
    unseen = observed.observed(scene, 2, GRIDS[0]) == 0
    assert torch.equal(strict == 255, unseen)
    assert torch.equal(strict[~unseen], free[~unseen])
    with pytest.raises(ValueError, match=r"data.ignore=void: choose none or unobserved"):
        VoxelCache(tmp_path, GRIDS[0], "void")


class OneRay(FakeFrames):
    """A scene without cameras, seen by one LiDAR ray along x."""

    def __init__(self, range_m: float, start_m: float | None = None):
        super().__init__("one ray", 0)
        origins = None if start_m is None else np.array([[start_m, 0, 0]], dtype=np.float32)
        ahead = np.array([[1, 0, 0]], dtype=np.float32)
        self.scan = LidarScan(np.array([range_m], dtype=np.float32), np.array([1], dtype=np.uint8), ahead, origins)

    def lidar(self, frame):
        return self.scan


def seen_by(scene: OneRay) -> list[int]:
    """Return which cells of 1 m along x were seen."""
    line = Cuboid((4, 1, 1), (0.0, 4.0), (-0.5, 0.5), (-0.5, 0.5))
    return observed.observed(scene, 0, line).flatten().tolist()


def test_points_and_rays_of_every_cell_are_counted(monkeypatch):
    scene, line = OneRay(2.5), Cuboid((4, 1, 1), (0.0, 4.0), (-0.5, 0.5), (-0.5, 0.5))
    points = Points(np.array([[2.5, 0, 0], [2.4, 0, 0], [9, 0, 0]], np.float32), np.ones(3, np.uint8))
    monkeypatch.setattr(scene, "points", lambda frame: points)
    monkeypatch.setattr(scene, "camera_range_m", lambda frame: None)
    counts = observed.cell_evidence(scene, 0, line).reshape(3, 4).tolist()
    assert counts == [[0, 0, 2, 0], [1, 1, 0, 0], [0, 0, 0, 0]]


def test_rays_of_equal_directions_are_told_apart_by_where_they_start():
    assert seen_by(OneRay(2.5)) == [1, 1, 0, 0]
    assert seen_by(OneRay(1.5, start_m=2.0)) == [0, 0, 1, 0]


def test_a_cell_in_which_the_hit_may_be_was_not_crossed():
    """Ranges are stored in steps of 4 mm: a hit at the end of the second cell may be inside of it."""
    assert seen_by(OneRay(2.0)) == [1, 0, 0, 0]
