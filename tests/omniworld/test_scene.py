import hashlib
import os
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest

from omniocc.camera import Rig
from omniworld import Frame, Scene
from omniworld.scene import ego_box
from omniworld.traffic.traffic import Actor


def _make() -> Scene:
    return Scene("suburb", 5, Rig.load("fisheye6").resized(32, 18), frame_interval_s=0.5, erp_size=(32, 8))


def _digest(frame: Frame) -> str:
    state = hashlib.sha256()
    for field in fields(frame):
        value = getattr(frame, field.name)
        state.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    return state.hexdigest()


@pytest.fixture(scope="module")
def scene():
    return _make()


@pytest.fixture(scope="module")
def frame(scene):
    return scene.frame(3)


def test_frame_has_the_documented_shapes(frame):
    assert frame.images.shape == (6, 18, 32, 3)
    assert frame.images.dtype == np.uint8
    assert frame.semantics.shape == frame.range_m.shape == (6, 18, 32)
    assert frame.erp_range_m.shape == (8, 32)
    assert frame.points_m.shape == (len(frame.point_labels), 3)
    assert frame.lidar_range_m.shape == frame.lidar_labels.shape == (14040,)
    assert frame.time_s == 1.5
    np.testing.assert_allclose(frame.world_from_ego[:3, :3] @ frame.world_from_ego[:3, :3].T, np.eye(3), atol=1e-9)
    assert set(np.unique(frame.point_labels)) <= set(range(1, 12))
    assert (np.isinf(frame.lidar_range_m) == (frame.lidar_labels == 0)).all()
    assert np.isnan(frame.range_m[frame.semantics == 255]).all()
    assert np.isinf(frame.range_m[frame.semantics == 0]).all()


def test_a_frame_does_not_depend_on_earlier_requests(scene, frame):
    assert _digest(scene.frame(0)) != _digest(frame)
    assert _digest(scene.frame(3)) == _digest(frame)


def test_a_frame_is_the_same_in_another_process_with_other_threads(frame):
    threads = "1" if os.environ.get("OMP_NUM_THREADS", "2") != "1" else "2"
    code = f"import runpy; m = runpy.run_path({__file__!r}); print(m['_digest'](m['_make']().frame(3)))"
    given = {"PYTHONPATH": ":".join(sys.path), "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    environment = os.environ | given  # which may name the kernels of BLAS
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert result.stdout.strip() == _digest(frame)


def test_the_ego_moves_and_static_points_stay_where_they_are(scene, frame):
    """Road points of one frame, carried to another by the poses, lie on the road seen there."""
    other = scene.frame(8)
    shift = np.linalg.norm(other.world_from_ego[:3, 3] - frame.world_from_ego[:3, 3])
    move = np.linalg.inv(other.world_from_ego) @ frame.world_from_ego
    ground = frame.points_m[frame.point_labels == 1].astype(np.float64) @ move[:3, :3].T + move[:3, 3]
    ground = ground[np.hypot(*ground[:, :2].T) < 12]
    cell = {}
    for point in other.points_m[other.point_labels == 1]:
        cell.setdefault((int(point[0] // 0.5), int(point[1] // 0.5)), []).append(point[2])
    gaps = [
        abs(np.mean(cell[key]) - point[2])
        for point in ground[::7]
        if (key := (int(point[0] // 0.5), int(point[1] // 0.5))) in cell
    ]
    assert shift > 1
    assert len(gaps) > 200
    assert np.percentile(gaps, 95) < 0.1


def test_another_seed_is_another_world(frame):
    other = Scene("suburb", 6, Rig.load("fisheye6").resized(32, 18), erp_size=(32, 8)).frame(3)
    one, two = frame.erp_range_m, other.erp_range_m
    assert (one != two)[np.isfinite(one) | np.isfinite(two)].mean() > 0.99
    assert np.abs(other.images.astype(int) - frame.images).mean() > 10


def test_another_rig_sees_the_same_world(frame):
    """Only what the cameras record depends on the rig."""
    rig = Rig.load("pinhole6").resized(32, 18)
    other = Scene("suburb", 5, rig, frame_interval_s=0.5, erp_size=(32, 8)).frame(3)
    for field in fields(Frame):
        mine, theirs = getattr(frame, field.name), getattr(other, field.name)
        if field.name in ("images", "semantics", "range_m"):
            assert not np.array_equal(mine, theirs)
        elif isinstance(mine, np.ndarray):
            assert np.array_equal(mine, theirs), field.name
        else:
            assert mine == theirs, field.name
    # The same light: the mean brightness of what both see differs little.
    assert abs(frame.images[frame.semantics < 255].mean() - other.images[other.semantics < 255].mean()) < 30


def test_each_option_changes_only_the_arrays_that_it_concerns(frame):
    def take(**options) -> Frame:
        rig = Rig.load("fisheye6").resized(32, 18)
        return Scene("suburb", 5, rig, frame_interval_s=0.5, erp_size=(32, 8), **options).frame(3)

    fog, complete, cube = take(weather="fog"), take(label_mode="geometry", lidars=3), take(capture="cubemap")
    points, images = {"points_m", "point_labels"}, {"images", "semantics", "range_m"}
    for other, changed in ((fog, {"images"}), (complete, points), (cube, images)):
        for field in ("images", "semantics", "range_m", "erp_range_m", "points_m", "point_labels", "lidar_range_m"):
            same = np.array_equal(getattr(frame, field), getattr(other, field), equal_nan=True)
            assert same != (field in changed), field
    assert set(np.unique(complete.point_labels)) >= set(np.unique(frame.point_labels))


def test_box_in_the_ego_frame():
    turned = np.array([[0.0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 2.2], [0, 0, 0, 1]])
    actor_pose = np.eye(4)
    actor_pose[:3, 3] = 10, 25, 0
    box = ego_box(Actor(7, 7, actor_pose, (4.0, 2.0, 1.5), (0.0, 3.0)), turned)
    np.testing.assert_allclose(box.center_m, (5, 0, -2.2 + 0.75), atol=1e-9)
    np.testing.assert_allclose(box.velocity_mps, (3, 0), atol=1e-9)
    assert box.yaw_rad == pytest.approx(-np.pi / 2)
    assert (box.id, box.label, box.size_m) == (7, 7, (4.0, 2.0, 1.5))


def test_boxes_hold_the_points_of_their_actors():
    frame = Scene("arterial", 5, Rig.load("fisheye6").resized(32, 18), erp_size=(32, 8)).frame(0)
    cars = [box for box in frame.boxes if box.label == 7 and np.hypot(*box.center_m[:2]) < 20]
    points = frame.points_m[frame.point_labels == 7]
    assert len(cars) == 2
    for box in cars:
        cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
        local = (points[:, :2] - box.center_m[:2]) @ np.array([[cos, -sin], [sin, cos]])
        near = (np.abs(local) < np.array(box.size_m[:2]) / 2 + 0.3).all(axis=1)
        assert near.sum() > 20


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"theme": "mars"}, "mars"),
        ({"supersample": 0}, "supersample is 0"),
        ({"frame_interval_s": 0.0}, "frame_interval_s is 0"),
        ({"erp_size": (0, 8)}, "erp_size"),
        ({"weather": "hail"}, "weather.*hail.*dusk"),
        ({"label_mode": "lidar"}, "label_mode.*lidar.*geometry"),
        ({"lidars": 0}, "lidars is 0"),
        ({"capture": "fast"}, "capture.*fast.*cubemap"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        Scene(**({"theme": "suburb", "seed": 0, "rig": Rig.load("fisheye6").resized(32, 18)} | options))


def test_negative_frames_are_refused(scene):
    with pytest.raises(ValueError, match="frame -1"):
        scene.frame(-1)
