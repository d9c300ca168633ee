import pickle
import shutil

import numpy as np
import pytest
import torch
from fake_scene import FakeWorld, fake_frame

from omniocc.data.dataset import Needs, WindowDataset, collate, window_frames
from omniocc.data.labels.voxels import VoxelCache
from omniocc.data.store import codec
from omniocc.errors import DataError
from omniocc.geometry import Cuboid, Cylinder

GRID = Cylinder(shape=(8, 10, 4), radius_m=(0.0, 25.6), height_m=(-2.8, 3.6))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    world = FakeWorld(tmp_path_factory.mktemp("world"))
    world.prepare()
    return world


@pytest.fixture
def own_world(world, tmp_path):
    shutil.copytree(world.root, tmp_path / "copy")
    return FakeWorld(tmp_path / "copy")


def dataset(world, window=1, geometry=GRID, split="train"):
    cache = VoxelCache(world.folder, geometry, fingerprint="fingerprint")
    cache.prepare(world.scenes(split))
    return WindowDataset(world.scenes(split), cache, window)


def votes(points_m, labels):
    """Most frequent class per cell, the highest id of a tie, in plain Python."""
    counts = {}
    for (x, y, z), label in zip(points_m.astype(np.float64), labels, strict=True):
        r, theta = np.hypot(x, y), np.arctan2(y, x)
        cell = int(r // 3.2), int((theta + np.pi) // (2 * np.pi / 10)), int((z + 2.8) // 1.6)
        if cell[0] < 8 and 0 <= cell[2] < 4:
            counts.setdefault(cell, np.zeros(12, dtype=int))[label] += 1
    grid = np.zeros((8, 10, 4), dtype=np.uint8)
    for cell, count in counts.items():
        grid[cell] = 11 - np.argmax(count[::-1])
    return grid


def test_cells_beyond_the_recorded_points_are_unknown(world, tmp_path):
    scene, reach_m = world.scenes("train")[0], (26.0, 26.0, 6.0)
    far = Cuboid((20, 10, 4), (-40.0, 40.0), (-25.0, 25.0), (-2.8, 7.6))
    whole, limited = (VoxelCache(tmp_path, far, reach_m=reach) for reach in (None, reach_m))
    limited.prepare([scene])
    labels, kept = whole.read(scene, 0), limited.read(scene, 0)
    unknown = kept == 255
    # centres are at 2, 6, ... 26, 30, 34, 38 m along x and at -1.5, 1.1, 3.7, 6.3 m along z
    along_x, along_z = unknown.all((1, 2)), unknown.all((0, 1))
    assert along_x.tolist() == [True] * 3 + [False] * 14 + [True] * 3
    assert along_z.tolist() == [False] * 3 + [True]
    assert torch.equal(unknown, along_x[:, None, None] | along_z.expand(20, 10, 4))
    assert torch.equal(kept[~unknown], labels[~unknown])
    assert (labels[~unknown] > 0).any()
    assert (labels[unknown] == 0).all()
    assert whole.folder != limited.folder
    assert VoxelCache(tmp_path, GRID).folder == VoxelCache(tmp_path, GRID, reach_m=reach_m).folder, "voted before"


def test_a_sample_holds_what_was_recorded(world):
    data = dataset(world)
    assert len(data) == 8
    sample = data[6]  # second scene, third frame
    frame = fake_frame(seed=1, index=2)
    assert sample.frame_id == "train-001-suburb/000002"
    assert sample.rigs == (world.rig,)
    images = np.stack([codec.decode_image(codec.encode_image(image)) for image in frame.images])
    np.testing.assert_array_equal(sample.images[0], images.transpose(0, 3, 1, 2))
    np.testing.assert_array_equal(sample.pixel_labels, frame.semantics)
    np.testing.assert_array_equal(sample.world_from_ego[0], frame.world_from_ego)
    np.testing.assert_allclose(sample.lidar_range_m, frame.lidar_range_m, atol=1 / 512, rtol=0)
    np.testing.assert_array_equal(sample.lidar_labels, frame.lidar_labels)
    points_m, labels = codec.decode_points(codec.encode_points(frame.points_m, frame.point_labels))
    np.testing.assert_array_equal(sample.voxels, votes(points_m, labels))


def test_ranges_of_0_and_below_are_no_measurements(world, monkeypatch):
    data = dataset(world)
    scene = data.scenes[0]
    panorama, (first, *others) = scene.erp_range_m(0), scene.camera_range_m(0)
    panorama[0, :3], first[0, :3] = (0, -1, 2), (-1, 3, 0)
    monkeypatch.setattr(type(scene), "erp_range_m", lambda scene, frame: panorama)
    monkeypatch.setattr(type(scene), "camera_range_m", lambda scene, frame: [first, *others])
    data.needs = Needs(panorama=True, camera_ranges=True)
    sample = data[0]
    torch.testing.assert_close(sample.erp_range_m[0, :3], torch.tensor([torch.nan, torch.nan, 2]), equal_nan=True)
    torch.testing.assert_close(sample.camera_range_m[0, 0, :3], torch.tensor([torch.nan, 3, torch.nan]), equal_nan=True)
    np.testing.assert_array_equal(sample.erp_range_m[1:], panorama[1:])


def test_a_window_never_crosses_the_beginning_of_its_scene(world):
    data = dataset(world, window=3)
    for index, frames in ((4, [0, 0, 0]), (5, [0, 0, 1]), (6, [0, 1, 2]), (7, [1, 2, 3])):
        sample = data[index]
        assert sample.world_from_ego[:, 0, 3].tolist() == [3.0 * frame for frame in frames]
        assert sample.exists.tolist() == [newest >= 0 for newest in range(index - 6, index - 3)]
        for at, frame in enumerate(frames):
            assert torch.equal(sample.images[at], data[4 + frame].images[-1])
    assert window_frames(newest=1, window=4) == [0, 0, 0, 1]


def test_collate_gives_a_batch(world):
    data = dataset(world, window=2)
    batch = collate([data[0], data[5], data[7]])
    assert batch.images.shape == (3, 2, 6, 3, 18, 32)
    assert batch.world_from_ego.shape == (3, 2, 4, 4)
    assert batch.world_from_ego.dtype == torch.float64
    assert batch.exists.tolist() == [[False, True], [True, True], [True, True]]
    assert batch.voxels.shape == (3, 8, 10, 4)
    assert batch.pixel_labels.shape == (3, 6, 18, 32)
    assert batch.lidar_range_m.shape == batch.lidar_labels.shape == (3, 14040)
    assert {t.dtype for t in (batch.images, batch.voxels, batch.pixel_labels, batch.lidar_labels)} == {torch.uint8}
    assert batch.rigs == ((world.rig, world.rig),) * 3
    assert batch.frame_ids == ("train-000-downtown/000000", "train-001-suburb/000001", "train-001-suburb/000003")


def test_a_pickled_dataset_is_small_and_can_be_read(world):
    data = dataset(world)
    data[0]
    blob = pickle.dumps(data)
    assert len(blob) < 3000  # no index, no open file
    assert torch.equal(pickle.loads(blob)[3].images, data[3].images)


def test_every_geometry_has_its_own_cache(world):
    other = Cuboid(shape=(6, 5, 4), x_m=(-20.0, 20.0), y_m=(-20.0, 20.0), height_m=(-2.8, 3.6))
    assert dataset(world, geometry=other)[0].voxels.shape == (6, 5, 4)
    assert dataset(world)[0].voxels.shape == (8, 10, 4)
    assert len(list(world.folder.glob("voxels-*"))) == 2


def test_a_damaged_voxel_cache_costs_a_warning_and_gives_the_same_labels(own_world):
    expected = dataset(own_world)[1].voxels
    folder = VoxelCache(own_world.folder, GRID).folder / "train-000-downtown"
    shard = folder / "frames-000.tar"
    raw = bytearray(shard.read_bytes())
    raw[600:2600] = bytes(2000)
    shard.write_bytes(raw)
    with pytest.warns(UserWarning, match=r"voxels.*train-000-downtown.*frame 1"):
        assert torch.equal(dataset(own_world)[1].voxels, expected)
    (folder / "index.json").write_text("{}")
    with pytest.warns(UserWarning, match=r"index\.json.*checksum"):
        assert torch.equal(dataset(own_world)[1].voxels, expected)
    assert torch.equal(dataset(own_world)[1].voxels, expected)  # made again: no warning any more


def test_damaged_recordings_are_one_error_naming_scene_frame_and_member(own_world):
    data = dataset(own_world)
    shard = data.scenes[1].folder / "frames-000.tar"
    offset = data.scenes[1].index.offset[0, 1]
    raw = bytearray(shard.read_bytes())
    raw[offset + 100] ^= 255
    shard.write_bytes(raw)
    with pytest.raises(DataError, match=r"train-001-suburb.*frame 0.*rgb0\.jpg.*checksum"):
        dataset(own_world)[4]


def test_class_counts_are_kept_and_counted_again_when_damaged(own_world, monkeypatch):
    data = dataset(own_world)
    expected = sum(torch.nn.functional.one_hot(data[i].voxels.long(), 12) for i in range(8)).permute(3, 0, 1, 2)
    counts = data.voxels.counts(data.scenes)
    assert counts.dtype == torch.int64
    assert torch.equal(counts, expected)
    with monkeypatch.context() as patch:
        patch.setattr(VoxelCache, "read", None)  # is not needed a second time
        assert torch.equal(data.voxels.counts(data.scenes), expected)
    kept = next(iter(data.voxels.folder.glob("counts-*")))
    raw = bytearray(kept.read_bytes())
    raw[len(raw) // 2] ^= 8
    kept.write_bytes(raw)
    with pytest.warns(UserWarning, match="is damaged"):
        assert torch.equal(data.voxels.counts(data.scenes), expected)


def test_unknown_cells_are_not_counted(own_world, monkeypatch):
    data = dataset(own_world)
    labels = torch.full(GRID.shape, 255, dtype=torch.uint8)
    labels[0, 0, 0] = 4
    monkeypatch.setattr(VoxelCache, "read", lambda *_: labels)
    counts = data.voxels.counts(data.scenes)
    assert counts.sum() == counts[4, 0, 0, 0] == 8
