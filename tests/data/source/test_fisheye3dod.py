"""Fisheye3DOD: a small dataset in the layout that its code reads, literal values of poses, pixels, tags, split."""

import numpy as np
import pytest
import torch
from rival_files import FISHEYE3DOD_FOCAL_PX, WALL_M, fisheye3dod_points, write_fisheye3dod

from omniocc.data import SceneSource
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError, UserError
from omniocc.extras.datasets.fisheye3dod import Fisheye3DOD, read_points, read_poses, town_of
from omniocc.geometry import Cuboid

TOWNS = {"train": ["Town01"], "val": ["Town03"], "test": ["Town02"]}
GRID = Cuboid((50, 50, 16), (-10, 10), (-10, 10), (-2.8, 3.6))
ROAD, WALL, VEHICLE = 1, 5, 7


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


def test_it_keeps_the_contracts_and_the_split_is_by_town(root):
    source = source_of(root)
    assert isinstance(source, SceneSource)
    names = {split: [scene.name for scene in source.scenes(split)] for split in TOWNS}
    assert names == {
        "train": ["train-Town01_Opt-ClearNoon-2024_09_23_11_44_45"],
        "val": ["train-Town03-ClearNoon-2024_09_23_11_44_45"],
        "test": ["train-Town02_Opt-ClearNoon-2024_09_23_11_44_45"],
    }
    assert town_of("train-Town10HD_Opt-SoftRainNight-2024_10_23_19_27_27") == "Town10HD"
    scene = source.scenes("test")[0]
    assert isinstance(scene, SceneFrames)
    assert scene.numbers == [26981, 26986]  # 10 recorded a second, two taken
    assert source.spec.frame_interval_s == 0.5
    assert [image.shape for image in scene.images(1)] == [(80, 80, 3)] * 4
    assert scene.images(1)[0].mean() == pytest.approx(100)
    with pytest.raises(ValueError, match="every town in one of them"):
        source_of(root, TOWNS | {"val": ["Town01"]})
    with pytest.raises(ValueError, match="unseen: there is no mask"):
        source.labels(GRID, "unseen")
    assert source.fingerprint != source_of(root, accumulate=1).fingerprint


def test_poses_are_the_mirror_image_of_carlas(root, tmp_path):
    scene = source_of(root).scenes("train")[0]
    first, second = scene.world_from_ego
    assert first[:3, 3].tolist() == pytest.approx([100, -50, 2.4])
    ahead = np.array([np.cos(np.radians(30)), -np.sin(np.radians(30)), 0])  # to the right is towards -y
    assert first[:3, 0].tolist() == pytest.approx(ahead.tolist())
    assert (second[:3, 3] - first[:3, 3]).tolist() == pytest.approx((2.5 * ahead).tolist(), abs=1e-5)
    line = "frame=7, x transform=Transform(Location(x=1.5, y=-0.7, z=1.6), Rotation(pitch=-10, yaw=35, roll=5))"
    (tmp_path / "sensor_metadata.txt").write_text(line)
    np.testing.assert_allclose(
        read_poses(tmp_path)[7][:3],
        ((0.8067073, 0.5837913, 0.0917125, 1.5), (-0.5648625, 0.8073542, -0.1706153, 0.7),
         (-0.1736482, 0.0858316, 0.9810603, 1.6)), atol=1e-6,
    )  # fmt: skip


def test_a_frame_has_one_pose(tmp_path):
    line = "frame=7, x transform=Transform(Location(x=1.5, y=-0.7, z=1.6), Rotation(pitch=-10, yaw=35, roll=5))\n"
    (tmp_path / "sensor_metadata.txt").write_text(2 * line)
    with pytest.raises(DataError, match=r"sensor_metadata\.txt: frame 7 stands twice"):
        read_poses(tmp_path)


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
    cloud = scene.cloud(0)
    assert len(cloud.points_m) == len(fisheye3dod_points()[0]) - 1 - int((cloud_of_road_below()).sum())
    assert set(cloud.labels.tolist()) == {ROAD, WALL, VEHICLE, 255}
    assert cloud.points_m[cloud.labels == WALL][:, 1] == pytest.approx(WALL_M)
    points = scene.points(1)  # its file is the last: three files vote
    assert (points.labels == WALL).sum() == 3 * (cloud.labels == WALL).sum()
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
    ranges_m, labels = scene.camera_range_m(0)[1], scene.pixel_labels(0)[1]
    assert ranges_m[labels == WALL].min() == pytest.approx(WALL_M - 1, abs=0.1)
    assert set(np.unique(labels)) == {ROAD, WALL, VEHICLE, 255} - {VEHICLE}  # the car is to the right


def cloud_of_road_below():
    points, tags = fisheye3dod_points()
    return (tags == 1) & (np.abs(points[:, 0]) <= 3) & (np.abs(points[:, 1]) <= 1.2)


def test_tags_are_read_as_carla_writes_them_or_as_floats(root, tmp_path):
    floats = write_fisheye3dod(tmp_path, frames=1, floats=True)
    one, other = (source_of(folder).scenes("train")[0].cloud(0) for folder in (root, floats))
    np.testing.assert_array_equal(one.labels, other.labels)
    old = source_of(root, carla_version="0.9.13").scenes("train")[0].cloud(0)
    assert set(old.labels.tolist()) == {4, 10, 3, 255}  # the same numbers: building, pedestrian, ground
    right = source_of(root, y="right").scenes("train")[0].cloud(0)
    assert right.points_m[right.labels == WALL][:, 1] == pytest.approx(-WALL_M)
    with pytest.raises(UserError, match="version is 'newest', which is no number"):
        source_of(root, carla_version="newest")
    path = tmp_path / "points.bin"
    path.write_bytes(np.full((3, 6), 0.5, "<f4").tobytes())
    with pytest.raises(DataError, match=r"points\.bin: the last of the six numbers of a point is no tag"):
        read_points(path)
    ways = np.array(
        [[0, 0, 0], [np.nan, 1, 1], [5, 4, 3]], "<f4"
    )  # two rays that did not come back, whatever their tag
    rows = np.column_stack([ways, np.zeros((3, 2), "<f4"), np.array([3.5, np.nan, 14], "<f4")]).astype("<f4")
    path.write_bytes(rows.tobytes())
    points_m, tags = read_points(path)
    assert points_m.tolist() == [[5, 4, 3]]
    assert tags.tolist() == [14]


FOLDER = "train-Town01_Opt-ClearNoon-2024_09_23_11_44_45/ego0"


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("calib_results.txt", "1 2\n", r"calib_results\.txt: 1 lines of numbers"),
        (f"{FOLDER}/semantic_lidar/sensor_metadata.txt", "nothing", "there is no 'frame=..., ... Transform"),
        (
            f"{FOLDER}/semantic_lidar/00026981.bin",
            "12345",
            r"Fisheye3DOD, scene 'train-Town01_Opt.*', frame 0: .*5 bytes",
        ),
        (f"{FOLDER}/semantic_lidar/00026981.bin", "", r"frame 0: .*00026981\.bin: the file is empty; copy it again"),
        (f"{FOLDER}/fisheye_camera_left/00026981.png", "no", r"frame 0: .*00026981\.png: the file is no image"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, file, content, message):
    root = write_fisheye3dod(tmp_path, frames=1)
    (root / file).write_text(content)
    with pytest.raises(DataError, match=message):
        read_all(root)


def read_all(root):
    scene = source_of(root).scenes("train")[0]
    return scene.rigs[0], scene.images(0), scene.points(0)


def test_a_town_that_is_not_there_is_named(root, tmp_path):
    with pytest.raises(DataError, match=r"no recording of Town07 is there, only of Town01, Town02, Town03; set data"):
        source_of(root, TOWNS | {"test": ["Town07"]})
    with pytest.raises(DataError, match=r"calib_results\.txt not found"):
        source_of(tmp_path)
