import math

import pytest
import torch

from omniocc.camera.pose import invert_pose
from omniocc.errors import DataError, UserError
from omniocc.predict.input.poses import read_poses, write_poses

HEAD = "frame,x_m,y_m,z_m,qw,qx,qy,qz\n"


def written(tmp_path, text):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    return path


def test_a_quaternion_is_a_rotation(tmp_path):
    half = math.sqrt(0.5)
    path = written(tmp_path, f"{HEAD}b,1,2,3,{half},0,0,{half}\n\n# another sequence\na,0,0,5,{half},{half},0,0\n")
    turned_left, rolled = read_poses(path, ["b", "a"])
    # ahead of a car that has turned left is the world's +y, its left is -x
    assert torch.allclose(turned_left @ torch.tensor([1.0, 0, 0, 1]).double(), torch.tensor([1.0, 3, 3, 1]).double())
    assert torch.allclose(turned_left @ torch.tensor([0.0, 1, 0, 1]).double(), torch.tensor([0.0, 2, 3, 1]).double())
    # rolled by 90 degrees about x: left points up
    assert torch.allclose(rolled @ torch.tensor([0.0, 1, 0, 1]).double(), torch.tensor([0.0, 0, 6, 1]).double())


def test_matrices_are_read_back_exactly(tmp_path):
    generator = torch.Generator().manual_seed(0)
    poses = torch.eye(4, dtype=torch.float64).repeat(3, 1, 1)
    poses[:, :3, :3] = torch.linalg.qr(torch.randn(3, 3, 3, generator=generator, dtype=torch.float64)).Q
    poses[:, :3, 0] *= torch.linalg.det(poses[:, :3, :3])[:, None]  # no reflections
    poses[:, :3, 3] = torch.randn(3, 3, generator=generator, dtype=torch.float64) * 100
    write_poses(tmp_path / "poses.csv", ["0", "1", "2"], poses)
    assert torch.equal(read_poses(tmp_path / "poses.csv", ["2", "0"]), poses[[2, 0]])
    assert torch.allclose(invert_pose(poses) @ poses, torch.eye(4, dtype=torch.float64), atol=1e-12)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("a,0,0,nan,1,0,0,0", ["line 2", "frame 'a'", "'nan' is no finite number"]),
        ("a,0,0,1e300,1,0,0,0", ["line 2", "its position is 1e+300 m away", "at most 1e+08"]),
        ("a,1,0,0,-1e9,0,1,0,0,0,0,1,0,0,0,0,1", ["line 2", "frame 'a'", "its position is 1e+09 m away"]),
        ("a,0,0,0,2,0,0,0", ["length is 2", "must be 1"]),
        ("a,0,0,0,1,0,0", ["6 numbers", "x_m,y_m,z_m,qw,qx,qy,qz"]),
        ("a,1,0,0,0,0,2,0,0,0,0,1,0,0,0,0,1", ["not a rigid pose"]),
        ("a,1,0,0,0,0,1,0,0,0,0,-1,0,0,0,0,1", ["not a rigid pose"]),
        ("a,0,0,0,1,0,0,0\na,0,0,0,1,0,0,0", ["line 3", "already has a pose"]),
        ("0001,0,0,0,1,0,0,0", ["no pose of frame 'a'", "0001"]),
        ("aa,0,0,0,1,0,0,0", ["no pose of frame 'a'", "is it 'aa'?"]),
        ("", ["no pose of frame 'a'"]),
    ],
)
def test_mistakes_are_named(tmp_path, line, words):
    with pytest.raises(UserError) as caught:
        read_poses(written(tmp_path, f"{HEAD}{line}\n"), ["a"])
    for word in ["poses.csv", *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize("header", ["frame,x,y,z,qx,qy,qz,qw", "# Frame; tx; ty; tz; q_x; q_y; q_z; q_w"])
def test_the_header_rules_the_order(tmp_path, header):
    mark = "; " if ";" in header else ","
    path = written(tmp_path, f"{header}\r\na,1,2,3,0,0,0.6,0.8\r\n".replace(",", mark))
    expected = tmp_path / "expected.csv"
    expected.write_text(f"{HEAD}a,1,2,3,0.8,0,0,0.6\n")
    assert torch.equal(read_poses(path, ["a"]), read_poses(expected, ["a"]))


def test_a_header_that_names_no_pose_is_named(tmp_path):
    with pytest.raises(
        DataError, match=r"poses\.csv, line 1: the header 'frame,a,b' names no column x, .*give frame,x,"
    ):
        read_poses(written(tmp_path, "frame,a,b\na,1,2\n"), ["a"])


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(OSError, match=r"nowhere\.csv"):
        read_poses(tmp_path / "nowhere.csv", ["a"])


def test_a_file_that_is_no_text_is_named(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_bytes(b"a,0,0,0,1,0,0,0\n\xff\xfe")
    with pytest.raises(DataError, match=r"poses\.csv: the file is damaged: it is no text"):
        read_poses(path, ["a"])


def test_ground_truth_of_euroc_is_no_matrix(tmp_path):
    euroc = read_poses(written(tmp_path, "a,1,2,3,0.8,0,0,0.6,9,9,9,9,9,9,9,9,9\n"), ["a"])
    assert torch.equal(euroc, read_poses(written(tmp_path, f"{HEAD}a,1,2,3,.8,0,0,.6\n"), ["a"]))
