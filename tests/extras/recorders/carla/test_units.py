"""Frames, tags and encodings of CARLA, each against literal values or the real client."""

import ast
from pathlib import Path

import numpy as np
import pytest

from omniocc.camera import Rig
from omniocc.camera.cubemap import FACES, look_up_rays
from omniocc.classes import WORLD_CLASSES
from omniocc.errors import UserError
from omniocc.extras.carla_tags import NEW, OLD, class_table, tags_of
from omniocc.extras.recorders.carla import client
from omniocc.extras.recorders.carla.frames import on_one_surface
from omniocc.extras.recorders.carla.sensors import (
    POINT,
    camera_cubes,
    cube_sensors,
    inverse_depth_of,
    lidar_sensors,
    read_bgra,
    read_points,
    rgb_of,
    tags_in,
)
from omniocc.extras.unreal import UnrealPose, pose_of, right_handed, right_handed_points, unreal_pose


@pytest.mark.parametrize(
    ("given", "rows", "place"),
    [
        ((0, 0, 0, 0, 90, 0), ((0, 1, 0), (-1, 0, 0), (0, 0, 1)), (0, 0, 0)),
        ((0, 0, 0, 30, 0, 0), ((0.8660254, 0, -0.5), (0, 1, 0), (0.5, 0, 0.8660254)), (0, 0, 0)),
        ((0, 0, 0, 0, 0, 30), ((1, 0, 0), (0, 0.8660254, -0.5), (0, 0.5, 0.8660254)), (0, 0, 0)),
        (
            (1.5, -0.7, 1.6, -10, 35, 5),
            (
                (0.8067073, 0.5837913, 0.0917125),
                (-0.5648625, 0.8073542, -0.1706153),
                (-0.1736482, 0.0858316, 0.9810603),
            ),
            (1.5, 0.7, 1.6),
        ),
    ],
)
def test_poses_have_their_literal_values(given, rows, place):
    pose = pose_of(UnrealPose(*given))
    np.testing.assert_allclose(pose[:3, :3], rows, atol=1e-6)
    np.testing.assert_allclose(pose[:3, 3], place)


def test_poses_are_those_of_the_real_client():
    carla = pytest.importorskip("carla", reason="the client of CARLA is not installed: pip install -e '.[carla]'")
    rng = np.random.default_rng(0)
    for x, y, z, pitch, yaw, roll in rng.uniform(-1, 1, (50, 6)) * (9, 9, 9, 89, 180, 180):
        transform = carla.Transform(carla.Location(x, y, z), carla.Rotation(pitch=pitch, yaw=yaw, roll=roll))
        pose = right_handed(np.array(transform.get_matrix()))
        np.testing.assert_allclose(pose_of(UnrealPose(x, y, z, pitch, yaw, roll)), pose, atol=5e-6)
        np.testing.assert_allclose(
            unreal_pose(pose_of(UnrealPose(x, y, z, pitch, yaw, roll))), (x, y, z, pitch, yaw, roll)
        )
        point = carla.Location(3.0, -2.0, 1.0)
        transform.transform(point)
        there = pose @ [*right_handed_points(np.array([[3.0, -2.0, 1.0]]))[0], 1]
        np.testing.assert_allclose(there[:3], (point.x, -point.y, point.z), atol=2e-5)


@pytest.mark.parametrize("pitch", [90.0, -90.0])
def test_straight_up_and_down_are_poses_too(pitch):
    pose = pose_of(UnrealPose(0, 0, 0, pitch, 40, 0))
    np.testing.assert_allclose(pose_of(unreal_pose(pose)), pose, atol=1e-12)


def test_tags_are_those_of_the_real_client():
    carla = pytest.importorskip("carla", reason="the client of CARLA is not installed: pip install -e '.[carla]'")
    table = class_table(NEW)
    tags_of_class = {
        "Road": "Roads",
        "Sidewalk": "Sidewalks",
        "Ground": "Terrain Ground",
        "Building": "Buildings",
        "Wall": "Walls Fences GuardRail",
        "Vegetation": "Vegetation",
        "Vehicle": "Car Truck Bus Train Motorcycle Bicycle",
        "Other": "Static Dynamic Other Water Bridge RailTrack",
        "Pole": "Poles TrafficLight TrafficSigns",
        "Pedestrian": "Pedestrians Rider",
        "Roadline": "RoadLines",
        "Free": "Sky",
    }
    expected = {tag: name for name, tags in tags_of_class.items() for tag in tags.split()}
    labels = {name: int(label) for name, label in carla.CityObjectLabel.names.items() if name not in ("Any", "NONE")}
    assert set(labels) == set(expected)
    for name, tag in labels.items():
        assert WORLD_CLASSES.names[table[tag]] == expected[name], name
    assert table[0] == 255


def test_each_version_has_its_tags():
    for version in ("0.9.14", "0.9.16", "0.9.16-12-gabcdef", "0.10.0"):
        assert tags_of(version) is NEW
    for version in ("0.9.13", "0.9.9.4", "0.8.4"):
        assert tags_of(version) is OLD
    assert (class_table(OLD)[7], class_table(NEW)[7]) == (1, 9)  # Roads before, TrafficLight since
    assert sorted(tag for tags in OLD.values() for tag in tags) == list(range(1, 23))
    assert sorted(tag for tags in NEW.values() for tag in tags) == list(range(1, 30))
    with pytest.raises(UserError, match="the server's version is 'master'"):
        tags_of("master")


def test_pixels_are_blue_green_red_alpha():
    raw = bytes([1, 2, 3, 255, 40, 50, 60, 255])
    pixels = read_bgra(raw, 1, 2)
    assert rgb_of(pixels).tolist() == [[[3, 2, 1], [60, 50, 40]]]
    assert tags_in(pixels).tolist() == [[3, 60]]
    with pytest.raises(ValueError, match="an image of 3x1 px has 8 bytes instead of 12"):
        read_bgra(raw, 1, 3)


def test_depth_has_24_bits_over_a_kilometre():
    depths = {(0, 0, 255): 0.015199185, (0, 1, 0): 0.0152588, (1, 0, 0): 3.9062502, (255, 255, 254): 999.99994}
    raw = b"".join(bytes([*code, 0]) for code in depths)
    inverse = inverse_depth_of(read_bgra(raw, 1, 4))[0]
    np.testing.assert_allclose(1 / inverse[:3], list(depths.values())[:3], rtol=1e-5)
    sky = inverse_depth_of(read_bgra(bytes([255, 255, 255, 0]), 1, 1))
    assert sky.tolist() == [[0.0]]
    assert inverse[3] == 0  # the last step counts as sky


def test_lidar_points_have_24_bytes():
    raw = np.array([(1.5, -2.5, 0.25, 0.5, 77, 14)], POINT).tobytes()
    assert len(raw) == 24
    assert read_points(raw).tolist() == [(1.5, -2.5, 0.25, 0.5, 77, 14)]
    with pytest.raises(ValueError, match="a scan has 23 bytes, which is no multiple of 24"):
        read_points(raw[:-1])


def test_ranges_are_blended_on_planes_only():
    plane, edge = [0.10, 0.11, 0.12, 0.13], [0.10, 0.20, 0.10, 0.20]
    bent = [0.10, 0.11, 0.12, 0.14]
    inverse = np.array([plane, edge, bent, plane], np.float32).T
    tags = np.array([[7] * 4, [7] * 4, [7] * 4, [7, 7, 8, 7]], np.uint8).T
    assert on_one_surface(inverse, tags).tolist() == [True, False, False, False]


def test_the_nearest_face_pixel_is_half_a_pixel_from_its_ray():
    rng = np.random.default_rng(1)
    rays = rng.normal(size=(3, 500))
    rays /= np.linalg.norm(rays, axis=0)
    found = look_up_rays(rays, 0.02)
    assert (found.inner, found.side, found.faces) == (100, 102, [0, 1, 2, 3, 4, 5])
    assert found.field_deg == pytest.approx(91.134, abs=1e-3)
    face, row, column = np.unravel_index(found.nearest, (6, 102, 102))
    on_plane = np.stack([(column - 50.5) / 50, (row - 50.5) / 50, np.ones(500)])
    back = np.einsum("pij,jp->ip", FACES[face], on_plane)
    cosine = (back * rays).sum(0) / np.linalg.norm(back, axis=0)
    assert np.degrees(np.arccos(cosine)).max() < np.degrees(0.02) * 0.75


def test_sensors_are_mounted_at_the_cameras():
    rig = Rig.load("fisheye6").resized(128, 72)
    vehicle_from_ego = np.eye(4)
    vehicle_from_ego[2, 3] = 2.2
    cube = camera_cubes(rig)[0]
    sensors = cube_sensors(cube, vehicle_from_ego, {"shutter_speed": 90})
    place = rig.ego_from_camera[0, :3, 3].numpy()
    for sensor in sensors:
        assert sensor["pose"][:3] == pytest.approx([place[0], -place[1], place[2] + 2.2])
        assert sensor["attributes"]["fov"] == pytest.approx(cube.lookup.field_deg)
    colour = [sensor for sensor in sensors if sensor["blueprint"] == "sensor.camera.rgb"]
    assert len(sensors) == 3 * len(cube.lookup.faces) == 3 * len(colour)
    assert colour[0]["attributes"]["shutter_speed"] == 90
    assert colour[0]["attributes"]["exposure_mode"] == "manual"
    assert 5 not in cube.lookup.faces  # a lens of under 250 degrees needs no face behind it


def test_lidars_turn_once_a_frame_and_stand_around_the_vehicle():
    sensors = lidar_sensors(20, 0.1, seed=4)
    assert [sensor["name"] for sensor in sensors] == [f"lidar/{k}" for k in range(20)]
    attributes = sensors[0]["attributes"]
    assert (attributes["rotation_frequency"], attributes["points_per_second"]) == (10.0, 64 * 2031 * 10)
    places = np.array([sensor["pose"][:3] for sensor in sensors[1:]])
    assert np.abs(places[:, :2]).max() <= 20
    assert places[:, 2].min() >= 1
    assert places[:, 2].max() <= 5
    assert sensors == lidar_sensors(20, 0.1, seed=4)
    assert sensors != lidar_sensors(20, 0.1, seed=5)


def test_the_capturing_process_runs_under_python_3_8():
    source = Path(client.__file__).read_text(encoding="utf-8")
    tree = ast.parse(source, feature_version=(3, 8))
    names = {name.name.split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    assert names == {"carla", "json", "os", "queue", "random", "signal", "struct", "sys", "time"}
    assert not any(isinstance(node, ast.ImportFrom) for node in ast.walk(tree))
    assert "removeprefix" not in source
