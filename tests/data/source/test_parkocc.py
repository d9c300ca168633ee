"""ParkOcc: a small dataset in the layout that its code reads."""

import warnings

import numpy as np
import pytest
from rival_files import write_parkocc

from omniocc.data import SceneSource
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.extras.datasets.parkocc import ParkOcc

ONE = {"train": ["8"], "val": ["8"], "test": ["8"]}
POSES, CAMERA, ROWS = "sequences/dataset_sence_8.yaml", "calib/left/results_left.csv", "sequences/8/9/occ_9.npy"


def source_of(root, sequences=ONE):
    source = ParkOcc(str(root), sequences, 64, (64, 32, 45.0, -45.0), road_z_m=-2.0, cache=None)
    source.prepare()
    return source


@pytest.mark.filterwarnings("ignore:ParkOcc")
def test_a_small_dataset_is_read(tmp_path):
    source = source_of(write_parkocc(tmp_path))
    scene = source.scenes("test")[0]
    assert isinstance(source, SceneSource)
    assert isinstance(scene, SceneFrames)
    assert (scene.name, scene.numbers) == ("8", ["9", "10", "11"])  # 12 has no pose
    assert scene.world_from_ego[:, 0, 3].tolist() == [4.5, 5.0, 5.5]
    assert [image.shape for image in scene.images(1)] == [(32, 64, 3)] * 4
    assert scene.images(1)[0].mean() == pytest.approx(100, abs=1)
    voxels = scene.own_voxels(0, "none")
    assert np.bincount(voxels.flatten(), minlength=6).tolist() == [1_280_000 - 8001, 1, 1600, 6400, 0, 0]
    assert voxels[170, 100, 10] == 1
    assert (source.labels(source.grid, "unobserved").read(scene, 0) == voxels).all()
    assert scene.benchmark(0).scored is None
    cells, inside = source.grid.flat_index(voxels.new_tensor(scene.cloud(0).points_m, dtype=float))
    assert inside.all()
    assert (voxels.flatten()[cells] == 2).all()  # the scan has hit the wall
    front, left, right, back = scene.camera_range_m(0)
    assert np.nanmin(left) == pytest.approx(4.05, abs=0.1)  # the camera is 1 m to the left of the LiDAR
    assert np.isnan(right).all()
    half = [np.isfinite(image[:, :32]).sum() > np.isfinite(image[:, 32:]).sum() for image in (front, back)]
    assert half == [True, False]


def test_the_public_scene_in_every_split_gives_a_warning(tmp_path):
    root = write_parkocc(tmp_path, scenes=("0", "1"), frames=(3,))
    with pytest.warns(UserWarning, match="scene 0 is for training and for scores.*no split exists"):
        source_of(root, {"train": ["0"], "val": ["1"], "test": ["0"]})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        source_of(root, {"train": ["0"], "val": ["1"], "test": ["1"]})


@pytest.mark.filterwarnings("ignore:ParkOcc")
@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        (ROWS, [[0, 0, 0, 1], [0, 0, 32, 1]], r"occ_9\.npy: row 1 is \[0, 0, 32, 1\], but the grid has"),
        (ROWS, [[-1, 0, 0, 1]], r"row 0 is \[-1, 0, 0, 1\]"),
        (ROWS, [[0, 0, 0, 7]], r"the class ids \[7\] are not in"),
        (ROWS, [[0.5, 0, 0, 1]], "the array of float64 holds values that are no whole numbers"),
        (ROWS, [[0, 0, 1]], r"the array has the shape \(1, 3\) instead of \(-1, 4\)"),
        (ROWS, "no", r"frame 0: .*occ_9\.npy: the file is damaged"),
        ("calib/left/calib_results_left.txt", "#polynomial\n1 2\n", r"calib_results_left\.txt: 1 lines of"),
        (CAMERA, "1,0,0\n", r"results_left\.csv: a pose has 3 numbers instead of 16"),
        (CAMERA, ",".join(["2"] * 16), r"results_left\.csv: the matrix: the 3x3 part"),
        (CAMERA, "1_0" + ",0" * 15, r"results_left\.csv: '1_0' is no finite number"),
        (POSES, "9: {matrix: ['١', 0]}", r"dataset_sence_8\.yaml: '١' is no finite number"),
        (POSES, "9: {headstamp: 1}", r"dataset_sence_8\.yaml: a frame has no 'matrix'"),
        (POSES, "9: {}\n'9': {}", r"dataset_sence_8\.yaml: frame 9 stands twice"),
        (POSES, "{}", r"sequences/8: no folder of a frame with a pose is in it"),
        ("sequences/8/9/front_9.jpg", "no", r"ParkOcc, scene '8', frame 0: .*front_9\.jpg: the file is no image"),
        ("velodyne/8/9/pc_9.bin", "12345", r"frame 0: .*pc_9\.bin: the file has 5 bytes"),
        ("calib", None, "calib not found"),
        ("sequences/8", None, "8 not found.*name the folders there in data"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    path = write_parkocc(tmp_path, frames=(9,)) / file
    if content is None:
        path.rename(tmp_path / "elsewhere")
    elif isinstance(content, str):
        path.write_text(content)
    else:
        np.save(path, np.array(content))
    with pytest.raises(DataError, match=message):
        read_all(tmp_path)


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.own_voxels(0, "none"), scene.cloud(0), scene.images(0)
