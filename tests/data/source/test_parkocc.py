"""ParkOcc: a small dataset in the layout that its code reads, and literal values of voxels and pixels."""

import warnings

import numpy as np
import pytest
import torch
from rival_files import FOCAL_PX, write_parkocc

from omniocc.data import SceneSource
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.extras.datasets.parkocc import GRID, ParkOcc, dense_voxels

ONE = {"train": ["8"], "val": ["8"], "test": ["8"]}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_parkocc(tmp_path_factory.mktemp("parkocc"))


def source_of(root, sequences=ONE, width=64):
    return ParkOcc(str(root), sequences, width, (64, 32, 45.0, -45.0), -2.0, None)


@pytest.fixture(scope="module")
def scene(root):
    return source_of(root).scenes("test")[0]


def test_it_keeps_the_contracts_and_frames_are_in_the_order_of_their_numbers(root, scene):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    assert isinstance(scene, SceneFrames)
    assert (scene.name, scene.numbers) == ("8", ["9", "10", "11"])  # 12 has no pose
    assert scene.world_from_ego[:, 0, 3].tolist() == [4.5, 5.0, 5.5]
    assert [image.shape for image in scene.images(1)] == [(32, 64, 3)] * 4
    assert scene.images(1)[0].mean() == pytest.approx(100, abs=1)
    assert scene.pixel_labels(0) is scene.lidar(0) is scene.points(0) is None
    with pytest.raises(ValueError, match="unseen: there is no mask"):
        source.labels(GRID, "unseen")


def test_the_public_scene_in_every_split_gives_a_warning(root, tmp_path):
    with pytest.warns(UserWarning, match="scene 8 is for training and for scores.*no split exists"):
        source_of(root).prepare()
    both = write_parkocc(tmp_path, scenes=("0", "1"), frames=(3,))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        source_of(both, {"train": ["0"], "val": ["1"], "test": ["1"]}).prepare()


def test_rows_become_voxels_and_what_no_row_names_is_free(root, scene):
    voxels = scene.own_voxels(0, "none")
    assert [int((voxels == k).sum()) for k in range(6)] == [1_280_000 - 6400 - 1600 - 1, 1, 1600, 6400, 0, 0]
    assert voxels[170, 100, 10] == 1
    assert voxels[0, 199, 31] == 0
    assert GRID.centers()[100, 150, 6].tolist() == pytest.approx([0.05, 5.05, -1.95], abs=1e-5)  # left is +y
    assert torch.equal(scene.own_voxels(0, "unobserved"), voxels)
    truth = scene.benchmark(0)
    assert truth.scored is None
    labels = source_of(root).labels(GRID, "none")
    assert torch.equal(labels.read(scene, 0), voxels)


def test_points_of_the_scan_are_in_the_voxels_and_pixels_of_the_wall(scene):
    cloud = scene.cloud(0)
    cells, inside = GRID.flat_index(torch.from_numpy(cloud.points_m))
    assert inside.all()
    assert (scene.own_voxels(0, "none").flatten()[cells] == 2).all()
    front, left, right, back = scene.camera_range_m(0)
    assert np.nanmin(left) == pytest.approx(4.05, abs=0.1)  # the camera is 1 m to the left of the LiDAR
    assert np.isnan(right).all()
    half = [np.isfinite(image[:, :32]).sum() > np.isfinite(image[:, 32:]).sum() for image in (front, back)]
    assert half == [True, False]


def test_a_point_has_the_pixel_of_an_equidistant_lens(root):
    rig = source_of(root, width=1920).rig
    pixels, valid = rig.project(torch.tensor([[7.0, 0.2, -1.3], [0.5, 4.0, -3.0]], dtype=torch.float64))
    assert pixels[0, 0].tolist() == pytest.approx([959.5 - FOCAL_PX * np.arctan(0.2 / 5), 539.5], abs=1e-6)
    assert pixels[1, 1].tolist() == pytest.approx([959.5, 539.5 + FOCAL_PX * np.arctan(2 / 3)], abs=1e-6)
    assert valid[:, 0].tolist() == [True, False, False, False]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([[0, 0, 32, 1]], r"row 0 is \[0, 0, 32, 1\], but the grid has \(200, 200, 32\) cells"),
        ([[0, 0, 0, 1], [-1, 0, 0, 1]], r"row 1 is \[-1, 0, 0, 1\]"),
        ([[0, 0, 0, 7]], r"the class ids \[7\] are not in"),
        ([[0, 0, 0, -1]], r"the class ids \[-1\] are not in"),
        ([[0.5, 0, 0, 1]], "the array of float64 holds values that are no whole numbers"),
        ([[0, 0, 1]], r"the array has the shape \(1, 3\) instead of \(-1, 4\)"),
    ],
)
def test_impossible_rows_are_named(tmp_path, rows, message):
    np.save(tmp_path / "occ.npy", np.array(rows))
    with pytest.raises(DataError, match=rf"occ\.npy: {message}"):
        dense_voxels(tmp_path / "occ.npy")


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        (
            "calib/left/calib_results_left.txt",
            "#polynomial coefficients\n1 2\n",
            r"calib_results_left\.txt: 1 lines of",
        ),
        ("calib/left/results_left.csv", "1,0,0\n", r"results_left\.csv: a pose has 3 numbers instead of 16"),
        ("calib/left/results_left.csv", ",".join(["2"] * 16), r"results_left\.csv: the matrix: the 3x3 part"),
        ("calib/left/results_left.csv", "1_0" + ",0" * 15, r"results_left\.csv: '1_0' is no finite number"),
        ("sequences/dataset_sence_8.yaml", "9: {matrix: ['١', 0]}", r"dataset_sence_8\.yaml: '١' is no finite number"),
        ("sequences/dataset_sence_8.yaml", "9: {headstamp: 1}", r"dataset_sence_8\.yaml: a frame has no 'matrix'"),
        ("sequences/dataset_sence_8.yaml", "[", r"dataset_sence_8\.yaml: "),
        ("sequences/dataset_sence_8.yaml", "9: {}\n9: {}", r"dataset_sence_8\.yaml: .*line 2: the key 9 is in line 1"),
        ("sequences/dataset_sence_8.yaml", "9: {}\n'9': {}", r"dataset_sence_8\.yaml: frame 9 stands twice"),
        ("sequences/8/9/front_9.jpg", "no", r"ParkOcc, scene '8', frame 0: .*front_9\.jpg: the file is no image"),
        ("velodyne/8/9/pc_9.bin", "12345", r"frame 0: .*pc_9\.bin: the file has 5 bytes"),
        ("sequences/8/9/occ_9.npy", "no", r"frame 0: .*occ_9\.npy: the file is damaged"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    root = write_parkocc(tmp_path, frames=(9,))
    (root / file).write_text(content)
    with pytest.raises(DataError, match=message):
        read_all(root)


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.own_voxels(0, "none"), scene.cloud(0), scene.images(0)


def test_a_wrong_root_or_scene_lists_what_it_expected(tmp_path):
    with pytest.raises(DataError, match="calib, sequences not found"):
        source_of(tmp_path).prepare()
    write_parkocc(tmp_path, frames=(9,))
    with pytest.raises(DataError, match=r"4 not found, it holds 8.*name the folders there in data\.source\.sequences"):
        source_of(tmp_path, ONE | {"test": ["4"]}).prepare()
