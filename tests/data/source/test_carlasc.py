"""CarlaSC: a small dataset in its layout."""

import numpy as np
import pytest
import torch
from dataset_files import write_carlasc

from omniocc.classes import UNKNOWN
from omniocc.data import SceneSource, WindowDataset, collate
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.extras.datasets.carlasc import CarlaSC
from omniocc.scores import Scores

SPLITS = {"train": "Train", "val": "Val", "test": "Test"}


def source_of(root, coordinates="cartesian"):
    source = CarlaSC(str(root), coordinates, SPLITS, (64, 32, 45.0, -45.0), None)
    source.prepare()
    return source


@pytest.mark.parametrize("coordinates", ["cartesian", "cylindrical"])
def test_it_keeps_the_contracts_and_turns_right_into_left(tmp_path, coordinates):
    source = source_of(write_carlasc(tmp_path, coordinates), coordinates)
    assert isinstance(source, SceneSource)
    scene = source.scenes("test")[0]
    assert isinstance(scene, SceneFrames)
    assert (scene.name, len(scene)) == ("test-Town01_Light", 3)
    assert scene.world_from_ego[:, :2, 3].tolist() == [[0, 0], [1, -0.5], [2, -1]]
    labels = scene.own_voxels(0, "none")
    building = (labels == 1).nonzero()
    assert set(building[:, 1].tolist()) == set(range(127 - 89, 127 - 79))  # y > 0 in Unreal is on our right
    assert (labels[..., 0] == 6).all()
    unobserved = scene.own_voxels(0, "unobserved")
    assert (unobserved[:, :28] == UNKNOWN).all()
    assert torch.equal(unobserved[:, 28:], labels[:, 28:])
    with pytest.raises(ValueError, match="unseen: there is no mask of what cameras see"):
        source.labels(source.grid, "unseen")


def test_the_lidar_and_the_voxels_are_scored(tmp_path):
    source = source_of(write_carlasc(tmp_path))
    scenes = source.scenes("test")
    scan = scenes[0].lidar(0)
    assert set(scan.labels) == {6}
    assert np.isfinite(scenes[0].erp_range_m(0)).sum() > 40
    assert scenes[0].camera_range_m(0) is scenes[0].pixel_labels(0) is None
    data = WindowDataset(scenes, source.labels(source.grid, "none"), 1, own_rays=True)
    batch, scores = collate([data[0]]), Scores(source.grid, source.spec)
    scores.update(batch.own_voxels, batch)
    found = scores.compute()
    assert found["voxel/miou"] == found["rayiou"] == 1
    assert found["lidar/rayiou/Road"] > 0.9
    assert not batch.scored.all()


def test_predictions_come_back(tmp_path):
    scene = source_of(write_carlasc(tmp_path)).scenes("test")[0]
    classes = np.arange(128 * 128 * 8).reshape(128, 128, 8) % 11
    path = tmp_path / scene.prediction_file(2)
    scene.write_prediction(path, classes.astype(np.uint8))
    np.testing.assert_array_equal(scene.read_prediction(path), classes)
    path.write_bytes(np.full((128, 128, 8), 30, "<u4").tobytes())
    with pytest.raises(DataError, match=r"the class ids \[30\] are not in the dataset's table, which has 0 to 10"):
        scene.read_prediction(path)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("evaluation/params.json", b"{}", r"params\.json: the file is damaged"),
        ("evaluation/params.json", b'{"grid_size": [1, 2, 3]}', r"grid_size is \(1, 2, 3\) instead of \(128, 128, 8\)"),
        ("evaluation/000000.label", b"12", r"CarlaSC, scene 'train-Town01_Light', frame 0: .*the file has 2 bytes"),
        ("evaluation/000000.label", np.full(131072, 40, "<u4").tobytes(), r"class ids \[40\] are not in"),
        ("velodyne/000000.bin", b"12", r"frame 0: .*000000\.bin: the file has 2 bytes"),
        ("poses.txt", b"1 0 0", r"poses\.txt, line 1: it has 3 numbers"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    root = write_carlasc(tmp_path)
    (root / "Cartesian" / "Train" / "Town01_Light" / "cartesian" / file).write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_all(root)


def test_a_missing_grid_is_named(tmp_path):
    message = r"root=\S+: Cylindrical/Train, .*, it holds Cartesian; give the folder that holds CarlaSC's Cylindrical"
    with pytest.raises(DataError, match=message):
        source_of(write_carlasc(tmp_path), "cylindrical")


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.own_voxels(0, "none"), scene.cloud(0), scene.world_from_ego
