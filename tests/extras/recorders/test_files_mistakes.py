"""What is wrong with a log in folders, or with the options for it, is one line."""

import shutil

import numpy as np
import pytest
from log_files import CLASSES, NPZ, first_image, lidar_option, rewrite

from omniocc.data import DataError, SceneReader
from omniocc.errors import UserError
from omniocc.extras.recorders.labels import read_point_classes


def empty(log, original):
    for path in (log / original.rig.names[0]).iterdir():
        path.unlink()


def damage(path, content=b"nothing"):
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("options", "harm", "words"),
    [
        (["time_unit=us", "poses_time_unit=ns"], None, "comes no nearer than"),
        (["time_unit=ms", "poses_time_unit=ns"], None, "Are the units of its times right"),
        (["cameras={frnt: front}"], None, "cameras: the rig has no camera 'frnt'; it has front"),
        (["cameras={front: nowhere}"], None, "cameras.front=nowhere: there is no folder"),
        (["cameras={front: front/*.jpeg}"], None, "holds none of .png"),
        (["reference=middle"], None, "reference=middle is no camera; cameras: front"),
        ([], empty, "holds none of .png, .jpg"),
        ([], lambda log, scene: damage(first_image(log, scene)), "the file is no image, or damaged"),
        ([], lambda log, scene: damage(log / "poses.csv", b"1,2,3\n"), "line 1: 2 numbers of a pose"),
        ([], lambda log, scene: damage(log / "poses.csv", b"t\n"), "holds no poses; is poses_format=csv right?"),
        ([], lambda log, scene: damage(log / "poses.csv", b"1,0,0,0,2,0,0,0"), "line 1: the pose: rotation"),
        ([], lambda log, scene: damage(log / "poses.csv", b"1,0,0,0,1,0,0,0\n" * 2), "line 2: a pose of this time"),
        ([], lambda log, scene: (log / "poses.csv").unlink(), "poses.csv: the file is missing"),
        (["poses_format=kitti"], None, "poses_times is for poses_format=kitti, and needed there"),
        (["rig=nothing.yaml"], None, "no rig file 'nothing.yaml'"),
        (
            [NPZ],
            lambda log, scene: damage(log / "classes.yaml", b"1: Road"),
            "the class ids [",
        ),
        ([NPZ], lambda log, scene: damage(log / "classes.yaml", b"[]"), "it must map ids"),
        (
            [NPZ],
            lambda log, scene: damage(log / "classes.yaml", b"1: free"),
            "the name 'free'",
        ),
        ([lidar_option("bin", CLASSES)], lambda log, scene: unlabel(log), "its points have no class ids"),
        ([lidar_option("bin", "columns: 7")], None, "it is damaged"),
        (
            [lidar_option("ply")],
            lambda log, scene: damage(sorted((log / "ply").iterdir())[0]),
            "the header of a PLY file is missing",
        ),
        ([lidar_option("empty")], lambda log, scene: (log / "empty").mkdir(), "lidar.folder=empty:"),
    ],
)
def test_mistakes_get_one_line(recorder, original, log_folder, tmp_path, options, harm, words):
    log = shutil.copytree(log_folder, tmp_path / "log")
    if harm is not None:
        harm(log, original)
    with pytest.raises((UserError, DataError)) as caught:
        recorder(*options, log=log).record(tmp_path / "scenes")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "scenes" / "train-000-own").exists()


def unlabel(log):
    for path in (log / "bin").glob("*.label"):
        path.unlink()


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("limit_s=0", "limit_s is 0; it must be above 0"),
        ("interval_s=-1", "interval_s is -1; it must be above 0"),
        ("name=a/b", "name is 'a/b'"),
        ("lidar={folder: npz}", "lidar.ego_from_lidar is missing"),
        ("lidar={foldr: npz}", "lidar has no option foldr"),
        (lidar_option("npz", "deskew: 5"), "lidar.deskew is 5; give true or false"),
        (lidar_option("npz", "own_car_m: [[2, 1, 0.4], [-2, -1, -0.4]]"), "the lowest and the highest x, y, z"),
        (lidar_option("npz", "own_car_m: [[a, 1, 1], [2, 2, 2]]"), "the lowest and the highest x, y, z"),
        ("lidar={folder: npz, ego_from_lidar: null}", "lidar.ego_from_lidar is missing"),
        ("lidar={folder: null, ego_from_lidar: 1}", "lidar.folder is missing"),
        ("lidar={folder: npz, ego_from_lidar: [1, 2]}", "lidar.ego_from_lidar is [1, 2]; give rows"),
        ("ego_from_pose_frame={position_m: [0, 0, 0]}", "it needs position_m and quaternion_wxyz"),
        ("panorama=[720,180,-45.0,45.0]", "need -90 <= bottom_deg < top_deg"),
        ("time_unit=minutes", "time_unit: 'minutes' is not one of 's', 'ms', 'us', 'ns'"),
    ],
)
def test_impossible_options_are_refused_before_anything_is_read(recorder, override, words):
    with pytest.raises(UserError) as caught:
        recorder(override)
    assert words in str(caught.value)


@pytest.mark.parametrize("rgb", ["5", "[1, 2]", "[1, 2, 300]", "[1, 2, 0.5]"])
def test_a_colour_is_three_numbers(rgb, tmp_path):
    (tmp_path / "classes.yaml").write_text(f"1: {{name: way, rgb: {rgb}}}\n")
    with pytest.raises(DataError, match=r"id 1 has rgb: .*; give three whole numbers from 0 to 255"):
        read_point_classes(tmp_path / "classes.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1: way\n2: car\n1: car", "line 3: the key 1 is in line 1 already; keep one"),
        ("1: {name: way, rgb: [1, 2, 3], name: car}", "line 1: the key 'name' is in line 1 already"),
        ("1: {name: way, rgb: [1, 2, 3]}\n2: {name: way, rgb: [1, 2, 4]}", "the class 'way' has the colours"),
        (
            "1: !!python/name:os.system",
            "line 1: the tag 'tag:yaml.org,2002:python/name:os.system' is none",
        ),
        ("[" * 1000, "line 1: it is nested in more than 100 levels"),
        ("1: way\0", "it is no text in UTF-8: line 1 holds the byte 0x00"),
    ],
)
def test_a_class_has_one_name_and_colour(tmp_path, text, message):
    (tmp_path / "classes.yaml").write_text(text)
    with pytest.raises(DataError, match=r"classes\.yaml: ") as caught:
        read_point_classes(tmp_path / "classes.yaml")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda points, labels: (points * 1000, labels), "looks like millimetres"),
        (lambda points, labels: (points + np.float64([5e5, 5e6, 400]), labels), "looks like world coordinates (UTM"),
        (
            lambda points, labels: (points * 0, labels),
            "none of its 0 points lies within 25.6 m: rays",
        ),
    ],
)
def test_a_log_without_a_point_within_reach_is_refused_before_anything_is_written(
    recorder, log_folder, tmp_path, change, words
):
    log = shutil.copytree(log_folder, tmp_path / "log")
    rewrite(log, change)
    with pytest.raises(DataError) as caught:
        recorder(NPZ, log=log).record(tmp_path / "scenes")
    assert "all 2 frames have hardly any points, in the first of them " in str(caught.value)
    assert str(caught.value).startswith(f"{min((log / 'npz').iterdir())}: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "scenes").glob("*"))


def test_a_lidar_that_looks_far_ahead_alone_is_recorded(recorder, log_folder, tmp_path, capsys):
    log = shutil.copytree(log_folder, tmp_path / "log")
    rewrite(log, lambda points, labels: (points + np.float32([0, 90, 0]), labels))
    assert len(SceneReader(recorder(NPZ, log=log).record(tmp_path / "scenes")[0])) == 2
    assert "2 of 2 frames have hardly any points, in the first of them none of its" in capsys.readouterr().err


def test_frames_without_a_point_within_reach_are_said(recorder, log_folder, tmp_path, capsys):
    log = shutil.copytree(log_folder, tmp_path / "log")
    rewrite(log, lambda points, labels: (points * 1000, labels), frames=1)
    scene = SceneReader(recorder(NPZ, log=log).record(tmp_path / "scenes")[0])
    assert len(scene) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "hardly any" in line]
    assert line.startswith("scene 'train-000-own': 1 of 2 frames have hardly any points, in the first of them ")
    assert "looks like millimetres" in line
