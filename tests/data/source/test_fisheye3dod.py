"""Fisheye3DOD: a small dataset in the layout that its code reads, and a literal pose of CARLA."""

import numpy as np
import pytest
import torch
from rival_files import FISHEYE3DOD_FOCAL_PX, WALL_M, fisheye3dod_points, write_fisheye3dod

from omniocc.data import SceneSource
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError, UserError
from omniocc.extras.datasets.fisheye3dod import Fisheye3DOD, read_points, read_poses
from omniocc.geometry import Cuboid

TOWNS = {"train": ["Town01"], "val": ["Town03"], "test": ["Town02"]}
GRID = Cuboid((50, 50, 16), (-10, 10), (-10, 10), (-2.8, 3.6))
ROAD, WALL, VEHICLE = 1, 5, 7
POSE = "frame=7, x transform=Transform(Location(x=1.5, y=-0.7, z=1.6), Rotation(pitch=-10, yaw=35, roll=5))\n"
METADATA = "sensor_metadata.txt"


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_fisheye3dod(tmp_path_factory.mktemp("fisheye3dod"))


def source_of(root, towns=TOWNS, width=80, **changes):
    options = {"views": "fisheye", "frame_step": 5, "accumulate": 2, "carla_version": "0.9.15", "y": "left"} | changes
    source = Fisheye3DOD(
        str(root), towns, **options, image_width=width, panorama=(64, 32, 45.0, -45.0), road_z_m=-2.4, cache=None
    )
    source.prepare()
    return source


def test_a_small_dataset_is_read(root):
    source = source_of(root)
    scene = source.scenes("train")[0]
    assert isinstance(source, SceneSource)
    assert isinstance(scene, SceneFrames)
    names = {split: [scene.name for scene in source.scenes(split)] for split in TOWNS}
    assert names == {
        "train": ["train-Town01_Opt-ClearNoon-2024_09_23_11_44_45"],
        "val": ["train-Town03-ClearNoon-2024_09_23_11_44_45"],
        "test": ["train-Town02_Opt-ClearNoon-2024_09_23_11_44_45"],
    }
    assert scene.numbers == [26981, 26986]  # 10 recorded a second, two taken
    assert source.spec.frame_interval_s == 0.5
    assert source.fingerprint != source_of(root, accumulate=1).fingerprint
    assert [image.shape for image in scene.images(1)] == [(80, 80, 3)] * 4
    assert scene.images(1)[0].mean() == pytest.approx(100)
    first, second = scene.world_from_ego
    assert first[:3, 3].tolist() == pytest.approx([100, -50, 2.4])
    ahead = np.array([np.cos(np.radians(30)), -np.sin(np.radians(30)), 0])  # to the right is towards -y
    assert first[:3, 0].tolist() == pytest.approx(ahead.tolist())
    assert (second[:3, 3] - first[:3, 3]).tolist() == pytest.approx((2.5 * ahead).tolist(), abs=1e-5)
    cloud = scene.cloud(0)
    points, tags = fisheye3dod_points()
    own_car = (tags == 1) & (np.abs(points[:, :2]) <= (3, 1.2)).all(axis=1)
    assert len(cloud.points_m) == len(points) - 1 - int(own_car.sum())
    assert set(cloud.labels.tolist()) == {ROAD, WALL, VEHICLE, 255}
    assert cloud.points_m[cloud.labels == WALL][:, 1] == pytest.approx(WALL_M)
    ranges_m, labels = scene.camera_range_m(0)[1], scene.pixel_labels(0)[1]
    assert ranges_m[labels == WALL].min() == pytest.approx(WALL_M - 1, abs=0.1)
    assert set(np.unique(labels)) == {ROAD, WALL, 255}  # the car is to the right


def test_a_pose_is_the_mirror_image_of_carlas(tmp_path):
    (tmp_path / METADATA).write_text(POSE)
    expected = """ 0.8067073 0.5837913  0.0917125 1.5
                  -0.5648625 0.8073542 -0.1706153 0.7
                  -0.1736482 0.0858316  0.9810603 1.6"""
    np.testing.assert_allclose(read_poses(tmp_path)[7][:3].ravel(), np.array(expected.split(), float), atol=1e-6)


def test_a_point_has_the_pixels_of_both_kinds_of_cameras(root):
    fisheyes = source_of(root, width=800).scenes("train")[0].rigs[0]
    assert fisheyes.ego_from_camera[1, :3, 3].tolist() == pytest.approx([0.5, 1.0, -1.4], abs=1e-5)  # left is +y
    point = torch.tensor([7.0, 1.0, -1.6], dtype=torch.float64)  # 5 m ahead of the front one, 1 m to its left
    pixels, valid = fisheyes.project(point)
    assert pixels[0].tolist() == pytest.approx([399.5 - FISHEYE3DOD_FOCAL_PX * np.arctan(0.2), 399.5], abs=1e-3)
    assert valid.tolist() == [True, True, True, False]  # 220 degrees reach beyond the sides
    pinholes = source_of(root, views="pinhole", width=1280).scenes("train")[0].rigs[0]
    pixels, valid = pinholes.project(torch.tensor([6.5, 1.0, -0.9], dtype=torch.float64))
    assert pixels[0].tolist() == pytest.approx([639.5 - 640 * 0.2, 359.5], abs=1e-3)  # 90 degrees from side to side
    assert valid.tolist() == [True, False, False, False, False, False]


def test_points_vote_and_what_moves_only_in_its_own_frame(root):
    source = source_of(root)
    scene = source.scenes("train")[0]
    points, alone = scene.points(1), scene.cloud(0)  # the file of frame 1 is the last: three files vote
    assert (points.labels == WALL).sum() == 3 * (alone.labels == WALL).sum()
    assert (points.labels == VEHICLE).sum() == 1
    assert points.points_m[points.labels == WALL][:, 1] == pytest.approx(WALL_M, abs=1e-4)
    assert points.points_m[points.labels == WALL][:, 0].min() == pytest.approx(-10, abs=1e-3)  # of the file 1 m behind
    cells = source.labels(GRID, "none").read(scene, 1)
    assert set(cells.unique().tolist()) == {0, ROAD, WALL, VEHICLE, 255}
    assert cells[45, 30, 11] == 255  # hit, without a tag
    assert (cells[10:40, 40, 3] == WALL).all()  # y from 6 to 6.4 m
    assert cells[42, 20, 3] == VEHICLE
    assert source.labels(GRID, "none").benchmark(scene, 1) is None
    assert (source.labels(GRID, "unobserved").read(scene, 1) == 255).any()


def test_tags_are_read_as_carla_writes_them_or_as_floats(root, tmp_path):
    floats = write_fisheye3dod(tmp_path, frames=1, floats=True)
    one, other = (source_of(folder).scenes("train")[0].cloud(0) for folder in (root, floats))
    np.testing.assert_array_equal(one.labels, other.labels)
    old = source_of(root, carla_version="0.9.13").scenes("train")[0].cloud(0)
    assert set(old.labels.tolist()) == {4, 10, 3, 255}  # the same numbers: building, pedestrian, ground
    right = source_of(root, y="right").scenes("train")[0].cloud(0)
    assert right.points_m[right.labels == WALL][:, 1] == pytest.approx(-WALL_M)
    path = tmp_path / "points.bin"
    # the first two rays did not come back, whatever their tag
    rows = np.array([[0, 0, 0, 0, 0, 3.5], [np.nan, 1, 1, 0, 0, np.nan], [5, 4, 3, 0, 0, 14]], "<f4")
    path.write_bytes(rows.tobytes())
    points_m, tags = read_points(path)
    assert (points_m.tolist(), tags.tolist()) == ([[5, 4, 3]], [14])


FOLDER = "train-Town01_Opt-ClearNoon-2024_09_23_11_44_45/ego0"
SCAN, POSES, LEFT = "semantic_lidar/00026981.bin", f"semantic_lidar/{METADATA}", "fisheye_camera_left"


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("../../calib_results.txt", b"1 2\n", r"calib_results\.txt: 1 lines of numbers"),
        ("../../calib_results.txt", None, r"calib_results\.txt not found"),
        (POSES, b"nothing", "there is no 'frame=..., ... Transform"),
        (POSES, 2 * POSE.encode(), r"sensor_metadata\.txt: frame 7 stands twice"),
        (POSES, POSE.encode(), r"sensor_metadata\.txt: it has no pose of frame 26981"),
        (f"{LEFT}/{METADATA}", POSE.encode(), r"fisheye_camera_left.*: it has no pose of frame 26981"),
        (SCAN, b"12345", r"Fisheye3DOD, scene 'train-Town01_Opt.*', frame 0: .*5 bytes"),
        (SCAN, b"", r"frame 0: .*00026981\.bin: the file is empty; copy it again"),
        (SCAN, None, r"semantic_lidar: there are no files such as 00026981\.bin"),
        (SCAN, np.full((3, 6), 0.5, "<f4").tobytes(), r"\.bin: the last of the six numbers of a point is no tag"),
        (f"{LEFT}/00026981.png", b"no", r"frame 0: .*00026981\.png: the file is no image"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    path = write_fisheye3dod(tmp_path, frames=1) / FOLDER / file
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_all(tmp_path)


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.rigs[0], scene.images(0), scene.points(0)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (
            {"towns": TOWNS | {"test": ["Town07"]}},
            DataError,
            "no recording of Town07 is there, only of Town01, ",
        ),
        ({"towns": TOWNS | {"val": ["Town01"]}}, ValueError, "every town in one of them"),
        ({"views": "all"}, ValueError, "views must be of fisheye, pinhole and y left or right, got all and left"),
        ({"frame_step": 0}, ValueError, "frame_step 1 and accumulate 0, got 80, 0 and 2"),
        ({"carla_version": "newest"}, UserError, "version is 'newest', which is no number"),
    ],
)
def test_impossible_options_are_named(root, options, error, message):
    with pytest.raises(error, match=message):
        source_of(root, **options)
