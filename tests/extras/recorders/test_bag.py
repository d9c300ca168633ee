"""A rendered scene, written as a bag of ROS 1 and 2 and imported again, is the same scene."""

import re
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

pytest.importorskip("rosbags")
from bag_files import BASE_OPTION, BagWriter, write_bag, write_image, write_info
from log_files import START_NS, built, rig_of
from test_files import same_rate

from omniocc.camera import KannalaBrandt, Pinhole, Rig
from omniocc.data import DataError, SceneReader
from omniocc.data.source.recorded import spec_of
from omniocc.errors import UserError
from omniocc.extras.recorders.bag import Bag
from omniocc.extras.recorders.messages import camera_of, cloud_of

CLASSES = "classes: {classes}"


@pytest.fixture(scope="module", params=[1, 2], ids=["ros1", "ros2"])
def bag(request, original, tmp_path_factory):
    name = "log.bag" if request.param == 1 else "log"
    return write_bag(original, tmp_path_factory.mktemp(f"ros{request.param}") / name, request.param)


@pytest.fixture
def recorder(bag, original, tmp_path, log_folder):
    rig_of(original).save(tmp_path / "rig.yaml")
    cameras = ", ".join(f"{name}: /{name}/image" for name in original.rig.names)

    def make(*overrides, lidar=f"{{topic: /points, classes: {log_folder / 'classes.yaml'}}}"):
        options = ["name=train-000-bag", f"bag={bag}", f"rig={tmp_path / 'rig.yaml'}", f"cameras={{{cameras}}}"]
        return built("bag", *options, "world_frame=map", BASE_OPTION, f"lidar={lidar}", *overrides)

    return make


def test_an_imported_bag_is_the_exported_scene(recorder, original, tmp_path):
    scene = SceneReader(recorder().record(tmp_path)[0])
    assert len(scene) == len(original)
    np.testing.assert_allclose(scene.world_from_ego, original.world_from_ego, rtol=0, atol=1e-9)
    assert same_rate(scene, original) > 0.999
    for ours, theirs in zip(scene.images(1), original.images(1), strict=True):
        assert np.abs(ours.astype(int) - theirs).mean() < 2  # JPEG twice
    assert scene.rig == rig_of(original)
    assert spec_of(scene).classes == spec_of(original).classes
    assert scene.meta["facts"]["missing"] == []


def test_odometry_gives_the_same_poses(recorder, original, tmp_path):
    scene = SceneReader(recorder("poses=/odometry", lidar="null").record(tmp_path)[0])
    np.testing.assert_allclose(scene.world_from_ego, original.world_from_ego, rtol=0, atol=1e-9)
    assert scene.points(0) is None


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("poses=/odo", "poses=/odo: the topic is not in the bag; topics that fit: /odometry"),
        ("poses=/points", "poses=/points: the topic is of type sensor_msgs/msg/PointCloud2"),
        ("cameras={front: /points}", "cameras.front=/points: the topic is of type"),
        ("cameras={middle: /front/image}", "cameras: the rig has no camera 'middle'"),
        ("world_frame=earth", "there is no chain of poses from 'earth' to 'base_link'; frames: base_link"),
        ("world_frame=lidar", "states no moving pose between 'lidar' and 'base_link'"),
        ("lidar={topic: /points, label_field: kind, ego_from_lidar: null}", "the field 'kind' is missing"),
        ("bag=nowhere.bag", "bag=nowhere.bag: there is no such file"),
    ],
)
def test_mistakes_get_one_line(recorder, tmp_path, override, words):
    with pytest.raises((UserError, DataError)) as caught:
        recorder(override).record(tmp_path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_damaged_bag_is_named(tmp_path):
    for name in ("log.bag", "log"):
        path = tmp_path / name
        path.write_bytes(b"nothing") if name == "log.bag" else path.mkdir()
        with pytest.raises(DataError, match="the bag cannot be read") as caught, Bag(path):
            pass
        assert str(path) in str(caught.value)


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "omniocc.extras.recorders.bag_reader", None)
    with pytest.raises(UserError, match=r"pip install .*'\.\[bag\]'"):
        Bag(tmp_path)


K = [40.0, 0, 31.5, 0, 41.0, 17.5, 0, 0, 1]
PLUMB_BOB = [-0.2, 0.05, 0.002, -0.003, 0.0]


@pytest.mark.parametrize("ros", [1, 2])
def test_cameras_from_camera_info(original, tmp_path, ros):
    path = tmp_path / ("log.bag" if ros == 1 else "log")
    with BagWriter(path, ros) as bag:
        poses = original.rig.ego_from_camera.numpy()
        bag.transforms("/tf_static", START_NS, [("base_link", "front", poses[0]), ("base_link", "rear", poses[1])])
        for at in range(2):
            now = START_NS + at * 10**8
            bag.transforms("/tf", now, [("odom", "base_link", np.eye(4))])
            for name in ("front", "rear"):
                write_image(bag, name, now, original.images(0)[0])
        write_info(bag, "front", START_NS, "equidistant", (64, 36), K, d=[0.01, 0.02, -0.01, 0.001])
        write_info(bag, "rear", START_NS, "plumb_bob", (64, 36), K, d=[0.0] * 5)
    cameras = "cameras={front: /front/image, rear: /rear/image}"
    infos = "camera_info={front: /front/camera_info, rear: /rear/camera_info}"
    made = built("bag", "name=train-000-bag", f"bag={path}", cameras, infos, "road_z_m=-2.0")
    scene = SceneReader(made.record(tmp_path)[0])
    front, rear = scene.rig.cameras
    assert front == KannalaBrandt(64, 36, (40.0, 41.0), (31.5, 17.5), (0.01, 0.02, -0.01, 0.001), 180.0)
    assert rear == Pinhole(64, 36, (40.0, 41.0), (31.5, 17.5))
    np.testing.assert_allclose(scene.rig.ego_from_camera.numpy(), poses[:2], atol=1e-12)
    assert isinstance(scene.rig, Rig)


def info(model, d, **more):
    roi = type("Roi", (), {"x_offset": 0, "y_offset": 0})()
    fields = {"k": K, "d": d, "distortion_model": model, "width": 64, "height": 36, "binning_x": 0, "binning_y": 0}
    return type("Info", (), fields | {"roi": roi} | more)()


FLOATS = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("label", 12, 7)]


def cloud(fields, rows):
    """Return a PointCloud2 of float32 fields: name, offset and type of each."""
    made = [SimpleNamespace(name=name, offset=at, datatype=kind, count=1) for name, at, kind in fields]
    data = np.array(rows, "<f4")
    sizes = {"point_step": data.strides[0], "row_step": data.nbytes, "width": len(data), "height": 1}
    return SimpleNamespace(fields=made, is_bigendian=False, data=data.tobytes(), **sizes)


def test_rays_of_a_bag_that_did_not_come_back_are_no_points():
    rows = [[1, 2, 3, 40], [0, 0, 0, 3.6], [np.nan, 1, 1, np.nan], [0, 0, 2, 7]]
    found = cloud_of(cloud(FLOATS, rows), None, "here")
    assert found.points_m.tolist() == [[1, 2, 3], [0, 0, 2]]
    assert found.labels.tolist() == [40, 7]
    turned = cloud_of(cloud([("label", 12, 7), ("z", 0, 7), ("y", 4, 7), ("x", 8, 7)], rows), None, "here")
    assert turned.points_m.tolist() == [[3, 2, 1], [2, 0, 0]]


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (FLOATS, "here: its field 'label': the array of float32 holds values that are no whole numbers: 3.5"),
        ([*FLOATS, ("x", 12, 7)], "here: the field 'x' stands twice"),
        ([*FLOATS[:3], ("label", 14, 7)], "here: the field 'label' ends beyond the 16 bytes of a point"),
    ],
)
def test_points_of_a_bag_that_are_ambiguous_are_refused(fields, words):
    with pytest.raises(DataError, match=re.escape(words)):
        cloud_of(cloud(fields, [[1, 2, 3, 3.5]]), None, "here")


def test_points_of_a_bag_that_fill_the_memory_are_refused():
    message = cloud(FLOATS, [[1, 2, 3, 4]])
    message.point_step, message.width, message.row_step = 2**32 - 1, 0, 0
    with pytest.raises(DataError, match=re.escape("here: a point has 4,294,967,295 bytes")):
        cloud_of(message, None, "here")


def test_a_row_that_is_too_short_for_its_points_is_told_not_the_bytes():
    message = cloud(FLOATS, [[1, 2, 3, 4], [5, 6, 7, 8]])
    message.row_step = 0
    with pytest.raises(DataError, match=r"its row_step is 0, but a row of 2 points of 16 bytes has 32; "):
        cloud_of(message, None, "here")


def test_many_fields_of_points_are_compared_in_no_time():
    fields = [*FLOATS, *((f"more{number}", 0, 2) for number in range(50_000))]
    assert cloud_of(cloud(fields, [[1, 2, 3, 4]]), None, "here").points_m.tolist() == [[1, 2, 3]]


def test_plumb_bob_is_that_of_opencv():
    camera = camera_of(info("plumb_bob", PLUMB_BOB), "here")
    points = np.random.default_rng(0).uniform([-1, -0.5, 1], [1, 0.5, 3], (100, 3))
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.reshape(K, (3, 3)), np.array(PLUMB_BOB))[0][:, 0]
    pixels, valid = camera.project(torch.from_numpy(points))
    np.testing.assert_allclose(pixels[valid].numpy(), expected[valid.numpy()], atol=1e-9)
    assert valid.sum() > 50


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (info("plumb_bob", [0.1, 0, 0, 0, 0.1]), "here: the distortion plumb_bob"),
        (info("rational_polynomial", [0.1] * 8), "here: the distortion rational_polynomial"),
        (info("equidistant", [0.1]), "here: coefficients"),
        (info("plumb_bob", [], binning_x=2), "binning and cut-outs"),
    ],
)
def test_cameras_that_no_model_has_are_refused(message, words):
    with pytest.raises(DataError, match=words):
        camera_of(message, "here")
