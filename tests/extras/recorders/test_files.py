"""A rendered scene, exported as a log in folders and imported again, is the same scene; mistakes get one line."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from log_files import (
    CLASSES,
    EGO_FROM_LIDAR,
    NPZ,
    START_NS,
    first_image,
    lidar_option,
    record,
    rewrite,
    rig_of,
    stamp_ns,
)
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import OCCUPANCY_CLASSES, UNKNOWN, WORLD_CLASSES
from omniocc.data import DataError, SceneReader
from omniocc.data.formats.poses import shift
from omniocc.data.formats.projected import onto_cameras, onto_panorama
from omniocc.data.labels.voxels import observed, vote
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.check import check_scene
from omniocc.data.store.codec import decode_frame
from omniocc.data.store.files import list_folders
from omniocc.errors import UserError
from omniocc.extras.recorders.log import Log, Scans, Timing, at_height, plan_frames
from omniocc.extras.recorders.log_scene import origin_lines, record_log
from omniocc.frame import Box
from omniocc.geometry import Cylinder
from omniocc.predict.input.poses import read_poses

GRID = Cylinder()
VEHICLE = 7


def same_rate(ours, theirs) -> float:
    """Return the fraction of equal voxels among those that are occupied in one of the scenes, over all frames."""
    ours, theirs = (torch.stack([vote(scene, k, GRID) for k in range(len(scene))]) for scene in (ours, theirs))
    occupied = (ours > 0) | (theirs > 0)
    return float((ours == theirs)[occupied].float().mean())


@pytest.mark.parametrize("kind", ["npz", "bin", "pcd", "ply"])
def test_an_imported_scene_is_the_exported_one(recorder, original, tmp_path, kind):
    scene = record(recorder, tmp_path, lidar_option(kind, CLASSES))
    assert len(scene) == len(original)
    assert check_scene(scene, len(original), 0.5) == []
    assert np.array_equal(scene.world_from_ego, original.world_from_ego)
    np.testing.assert_allclose(scene.time_s, original.time_s, atol=5e-7)  # float64 seconds since 1970
    assert scene.rig == Rig.load(tmp_path / "train-000-own" / "rig.yaml") == rig_of(original)
    assert same_rate(scene, original) > 0.999
    for frame in range(len(scene)):
        for ours, theirs in zip(scene.images(frame), original.images(frame), strict=True):
            assert np.abs(ours.astype(int) - theirs).mean() < 2  # JPEG twice
    assert spec_of(scene).classes == WORLD_CLASSES
    assert scene.pixel_labels(0) is scene.lidar(0) is None
    scan, points_m = scene.scan(0), scene.points(0).points_m
    np.testing.assert_array_equal(scan.origins, np.broadcast_to(EGO_FROM_LIDAR[:3, 3], points_m.shape))
    np.testing.assert_allclose(scan.origins + scan.range_m[:, None] * scan.directions, points_m, atol=1e-4)
    assert scan.moving is None, "a log has no boxes"
    facts = scene.meta["facts"]
    assert (facts["moving"], facts["missing"], facts["start_s"]) == (None, [], START_NS / 1e9)


def test_ranges_are_those_of_the_points_and_sparse(recorder, original, tmp_path):
    scene = record(recorder, tmp_path, lidar_option("npz"), "panorama=[90,24,45.0,-45.0]", "moving=false")
    points, ranges, panorama = scene.points(1), scene.camera_range_m(1), scene.erp_range_m(1)
    assert set(points.labels.tolist()) == {1}
    assert spec_of(scene).classes == OCCUPANCY_CLASSES
    assert scene.meta["facts"]["moving"] is False
    assert panorama.shape == (24, 90)
    assert 0.05 < np.isfinite(panorama).mean() < 1
    # every range of a pixel is that of a point which our own projection puts there
    camera = 2
    origin = scene.rig.ego_from_camera[camera, :3, 3]
    pixels, valid = scene.rig.project_into(camera, torch.from_numpy(points.points_m).double())
    far_m = np.linalg.norm(points.points_m - origin.numpy(), axis=1)
    for v, u in np.argwhere(np.isfinite(ranges[camera]))[::50]:
        here = valid.numpy() & (pixels.round().numpy() == (u, v)).all(1)
        assert abs(far_m[here].min() - ranges[camera][v, u]) < 0.02  # points are stored in steps of 1/128 m
    # and is at most that of the surface that was rendered, which hides what is behind
    dense = original.camera_range_m(1)[camera]
    both = np.isfinite(dense) & np.isfinite(ranges[camera])
    assert np.median(np.abs(dense - ranges[camera])[both] / dense[both]) < 0.05


def test_points_of_a_scan_at_another_time_are_moved_by_the_motion_between(recorder, original, log_folder, tmp_path):
    log = shutil.copytree(log_folder, tmp_path / "log")
    late_ns = 100_000_000
    for frame in range(len(original)):
        (log / "npz" / f"{stamp_ns(original, frame)}.npz").rename(
            log / "npz" / f"{stamp_ns(original, frame, late_ns)}.npz"
        )
    at_once = SceneReader(recorder(lidar_option("npz")).record(tmp_path / "same")[0])
    options = lidar_option("npz"), "limit_s=0.2"
    later = SceneReader(recorder(*options, log=log).record(tmp_path / "later")[0])
    motion = np.linalg.inv(original.world_from_ego[0]) @ moved_by(original, late_ns / 1e9)
    assert np.linalg.norm(motion[:3, 3]) > 0.3
    expected = at_once.points(0).points_m @ motion[:3, :3].T + motion[:3, 3]
    apart_m, _ = cKDTree(later.points(0).points_m).query(expected)  # stored in another order, in steps of 1/128 m
    assert len(later.points(0).points_m) == len(expected)
    assert apart_m.max() < 0.02
    began_m = at_once.scan(0).origins[0]
    assert np.allclose(later.scan(0).origins, motion[:3, :3] @ began_m + motion[:3, 3], atol=1e-4)
    assert np.allclose(later.scan(0).range_m.max(), at_once.scan(0).range_m.max(), atol=0.02)
    points_m, rig = later.points(0).points_m, later.rig
    panorama = Equirectangular(later.erp_range_m(0).shape[1], later.erp_range_m(0).shape[0], 45.0, -45.0)
    shown = np.stack([image.range_m for image in onto_cameras(points_m, None, rig)]), later.camera_range_m(0)
    around = onto_panorama(points_m, None, panorama).range_m, later.erp_range_m(0)
    for projected, stored in (shown, around):
        both = np.isfinite(projected) & np.isfinite(stored)
        assert both.sum() > 0.9 * np.isfinite(stored).sum()
        assert (np.abs(projected - stored)[both] < 0.1).mean() > 0.95


def test_boxes_of_a_log_tell_what_moves_and_go_along_with_the_scan(recorder, original, log_folder, tmp_path):
    # scans are 0.1 s after their frames
    late_ns = 100_000_000
    log = shutil.copytree(log_folder, tmp_path / "log")
    for frame in range(len(original)):
        names = (f"{stamp_ns(original, frame, late)}.npz" for late in (0, late_ns))
        (log / "npz" / next(names)).rename(log / "npz" / next(names))
    made = recorder(NPZ, "limit_s=0.2", log=log)
    points = original.points(0)
    car = int(np.flatnonzero(points.labels == VEHICLE)[0])
    box = Box(3, VEHICLE, tuple(points.points_m[car].tolist()), (4.0, 2.0, 1.5), 0.5, (6.0, 0.0))
    with made.open() as opened:
        boxed = replace(opened, scans=replace(opened.scans, boxes=lambda number: (box,)))
        folder = record_log(boxed, tmp_path / "train-000", made.timing, made.options)
        low = record_log(at_height(boxed, 1.5, -2.2), tmp_path / "train-001", made.timing, made.options)
    scene, lower = SceneReader(folder), SceneReader(low)
    motion = np.linalg.inv(original.world_from_ego[0]) @ moved_by(original, late_ns / 1e9)
    (kept,), (down,) = (decode_frame(one.read(0, one.index.members)).boxes for one in (scene, lower))
    np.testing.assert_allclose(kept.center_m, motion[:3, :3] @ box.center_m + motion[:3, 3], atol=1e-6)
    assert kept.yaw_rad == pytest.approx(0.5 + np.arctan2(motion[1, 0], motion[0, 0]), abs=1e-6)
    np.testing.assert_allclose(down.center_m, np.add(kept.center_m, (0, 0, 0.7)), atol=1e-2)
    scan = scene.scan(0)
    assert set(scan.labels[scan.moving].tolist()) == {VEHICLE}
    ends_m = (scan.origins + scan.range_m[:, None] * scan.directions)[scan.moving]
    assert (np.abs(ends_m - kept.center_m)[:, :2] < 3).all()
    np.testing.assert_array_equal(lower.scan(0).moving.sum(), scan.moving.sum())


def moved_by(scene, time_s):
    """Return the pose of the car some time after the first frame of a scene."""
    begin, end = scene.world_from_ego[:2]
    part = time_s / (scene.time_s[1] - scene.time_s[0])
    pose = np.eye(4)
    pose[:3, :3] = Slerp([0, 1], Rotation.from_matrix([begin[:3, :3], end[:3, :3]]))(part).as_matrix()
    pose[:3, 3] = begin[:3, 3] + part * (end[:3, 3] - begin[:3, 3])
    return pose


def test_scans_beside_sparse_poses_lose_no_frame():
    """Frames on the stamps of poses that are farther apart than `pose_gap_s`, scans a little later."""
    at_s = 2.0 * np.arange(3)
    poses = np.stack([shift(10.0 * k, 0.0, 0.0) for k in range(3)])
    scans = Scans(at_s + 0.005, lambda number: None, str, OCCUPANCY_CLASSES, np.zeros(3))
    rig = Rig.load("fisheye6")
    log = Log("here", rig, (at_s,) * len(rig.names), lambda camera, number: None, at_s, poses, scans=scans, facts={})
    plan = plan_frames(log, Timing(None, 0.05, None, 1.0))
    assert len(plan.times_s) == 3
    np.testing.assert_allclose(plan.ego_from_scan[:, 0, 3], 0.025, atol=1e-9)  # at 5 m/s, beyond the last pose too


def test_an_older_recording_does_not_tell_where_its_rays_start(recorder, tmp_path):
    scene = record(recorder, tmp_path, lidar_option("npz"))
    for position_m in (None, "ahead", [0, 0], [0, 0, float("nan")]):
        scene.meta["facts"]["lidar_position_m"] = position_m
        with pytest.raises(DataError, match=r"it does not state where the LiDAR was; remove the scene") as caught:
            scene.scan(0)
        assert str(scene.folder) in str(caught.value)


def test_a_scene_without_lidar_has_images_and_poses_alone(recorder, original, tmp_path):
    scene = record(recorder, tmp_path)
    assert scene.index.members == ("frame.json", *(f"rgb{k}.jpg" for k in range(len(original.rig.names))))
    parts = scene.points, scene.erp_range_m, scene.camera_range_m, scene.pixel_labels, scene.lidar
    assert [part(0) for part in parts] == [None] * 5
    frame = decode_frame(scene.read(0, scene.index.members))
    assert frame.points_m is frame.range_m is frame.semantics is None
    assert observed(scene, 0, GRID).sum() == 0
    with pytest.raises(DataError, match=r"no points are recorded.*not training"):
        vote(scene, 0, GRID)


def test_a_scene_is_made_once(recorder, tmp_path):
    first = recorder().record(tmp_path)[0]
    before = (first / "meta.json").stat().st_mtime_ns
    assert recorder().record(tmp_path) == [first]
    assert (first / "meta.json").stat().st_mtime_ns == before
    with pytest.raises(DataError, match="made from something else; choose another name, or remove it"):
        recorder("limit_s=0.02").record(tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        lidar_option("npz", "own_car_m: [[-1, -1, -3], [1, 1, 3]]"),
        lidar_option("bin"),
        "cameras={front: front_left, front_left: front}",
    ],
)
def test_a_corrected_calibration_is_not_taken_for_the_old_one(recorder, original, tmp_path, change):
    cameras = "cameras={front: front, front_left: front_left}"
    assert {"front", "front_left"} <= set(original.rig.names)
    recorder(lidar_option("npz"), cameras).record(tmp_path)
    changed = [lidar_option("npz"), change] if change.startswith("cameras") else [change, cameras]
    with pytest.raises(DataError, match="made from something else"):
        recorder(*changed).record(tmp_path)


def test_after_a_damaged_file_the_same_command_makes_the_scene(recorder, original, log_folder, tmp_path):
    log = shutil.copytree(log_folder, tmp_path / "log")
    last = sorted((log / original.rig.names[0]).iterdir())[-1]
    whole = last.read_bytes()
    last.write_bytes(bytes(len(whole)))
    for option in ("limit_s=0.02", "limit_s=0.03"):
        with pytest.raises(DataError, match=f"{last.name}: the file is no image"):
            recorder(option, log=log).record(tmp_path)
    assert list_folders(tmp_path, "meta.json") == []
    last.write_bytes(whole)
    (folder,) = recorder(log=log).record(tmp_path)  # of other options than what is left of it
    (fresh,) = recorder(log=log).record(tmp_path / "fresh")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        path.name: path.read_bytes() for path in fresh.iterdir()
    }
    assert not list(tmp_path.glob("*.partial"))


def test_a_wrong_unit_and_a_name_without_a_split_are_said(recorder, tmp_path, capsys):
    loose = "time_unit=us", "poses_time_unit=us", "limit_s=100", "pose_gap_s=1000"
    with pytest.raises(UserError, match=r"frames are 500 s apart.*unit of the times right"):
        recorder(*loose).record(tmp_path)
    recorder(name="town").record(tmp_path)
    said = capsys.readouterr().err
    assert "'town' has to be named in data.source.splits" in said
    assert "0.5 s apart" in said


def test_images_of_another_size_and_some_cameras(recorder, original, tmp_path):
    names = original.rig.names[1], original.rig.names[0]
    cameras = f"cameras={{{names[0]}: {names[0]}, {names[1]}: {names[1]}/*.png}}"
    scene = record(recorder, tmp_path, cameras, "image_size=[32,18]", f"reference={names[1]}", "road_z_m=-1.5")
    assert scene.rig.names == names
    assert [image.shape for image in scene.images(0)] == [(18, 32, 3)] * 2
    assert scene.rig.road_z_m == spec_of(scene).road_z_m == -1.5


def test_rigs_at_other_heights_get_one_origin_above_the_road(recorder, original, tmp_path):
    """The log has the road 2.2 m below its origin; recorded 1.3 m below, all lies .9 m higher."""
    options, raised_m = (lidar_option("npz", CLASSES), "panorama=[90,24,45.0,-45.0]"), -2.2 + 1.3
    before = record(recorder, tmp_path / "as_it_is", *options)
    scene = record(recorder, tmp_path / "raised", *options, "origin_above_road_m=1.3")
    assert scene.rig.road_z_m == spec_of(scene).road_z_m == -1.3
    assert scene.rig == replace(before.rig.raised(raised_m), road_z_m=-1.3)
    position_m = EGO_FROM_LIDAR[:3, 3] - [0, 0, raised_m]
    np.testing.assert_allclose(scene.scan(0).origins[0], position_m, atol=1e-6)
    expected = before.world_from_ego @ shift(0.0, 0.0, raised_m)
    np.testing.assert_allclose(scene.world_from_ego, expected, atol=1e-9)
    for frame in range(len(scene)):
        grid = replace(GRID, height_m=tuple(z_m + raised_m for z_m in GRID.height_m))
        ours, theirs = vote(scene, frame, GRID), vote(before, frame, grid)
        assert (ours == theirs)[(ours > 0) | (theirs > 0)].float().mean() > 0.99
        points_m = before.points(frame).points_m - np.float32([0, 0, raised_m])
        around, found = (
            onto_panorama(points_m, None, Equirectangular(90, 24, 45.0, -45.0)).range_m,
            scene.erp_range_m(frame),
        )
        both = np.isfinite(around) & np.isfinite(found)
        assert both.sum() > 0.9 * np.isfinite(found).sum()
        assert (np.abs(around - found)[both] < 0.1).mean() > 0.95
    same = record(recorder, tmp_path / "raised", *options, "origin_above_road_m=1.3")
    assert same.meta["facts"]["recipe"] == scene.meta["facts"]["recipe"] != before.meta["facts"]["recipe"]
    on_the_road = record(recorder, tmp_path / "base", "road_z_m=0", "origin_above_road_m=2.2")
    assert on_the_road.rig.road_z_m == -2.2
    with pytest.raises(ValueError, match="origin_above_road_m is -1; it must be above 0"):
        recorder("origin_above_road_m=-1")


def kitti(log, original):
    rows = original.world_from_ego[:, :3].reshape(-1, 12)
    (log / "poses.txt").write_text("\n".join(" ".join(map(repr, row)) for row in rows.tolist()))
    times = [repr(stamp_ns(original, k) / 1e9) for k in range(len(original))]
    (log / "times.txt").write_text("\n".join(times))
    return "poses_format=kitti", "poses=poses.txt", "poses_times=times.txt"


def tum(log, original):
    from scipy.spatial.transform import Rotation

    poses = original.world_from_ego
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()  # x, y, z, w
    rows = np.column_stack([poses[:, :3, 3], quaternions]).tolist()
    stamps = [repr(stamp_ns(original, k) / 1e9) for k in range(len(original))]
    lines = [" ".join([stamp, *map(repr, row)]) for stamp, row in zip(stamps, rows, strict=True)]
    (log / "poses.txt").write_text("# time x y z qx qy qz qw\n" + "\n".join(lines))
    return "poses_format=tum", "poses=poses.txt"


@pytest.mark.parametrize("write", [kitti, tum])
def test_other_formats_of_poses(recorder, original, log_folder, tmp_path, write):
    log = shutil.copytree(log_folder, tmp_path / "log")
    options = write(log, original)
    (folder,) = recorder(*options, log=log).record(tmp_path)
    np.testing.assert_allclose(SceneReader(folder).world_from_ego, original.world_from_ego, atol=1e-9, rtol=0)


def test_poses_of_another_frame_and_between_the_images(recorder, original, log_folder, tmp_path):
    log = shutil.copytree(log_folder, tmp_path / "log")
    offset = np.eye(4)
    offset[:3, 3] = 1.0, -0.5, 0.25  # ego_from_pose_frame
    poses = original.world_from_ego @ offset
    rows = [[stamp_ns(original, k) / 1e3, *poses[k].ravel().tolist()] for k in range(len(poses))]
    (log / "poses.csv").write_text("\n".join(",".join(map(repr, row)) for row in rows))
    option = "ego_from_pose_frame={position_m: [1.0, -0.5, 0.25], quaternion_wxyz: [1, 0, 0, 0]}"
    (folder,) = recorder(option, "poses_time_unit=us", log=log).record(tmp_path)
    # the times of the file are rounded to a quarter of a microsecond
    np.testing.assert_allclose(SceneReader(folder).world_from_ego, original.world_from_ego, atol=1e-4, rtol=0)


def test_times_from_a_table(recorder, original, log_folder, tmp_path):
    log = shutil.copytree(log_folder, tmp_path / "log")
    lines = ["time,file"]
    for name in original.rig.names:
        for k, path in enumerate(sorted((log / name).iterdir())):
            path.rename(path.with_name(f"image-{k}.png"))
            lines.append(f"{stamp_ns(original, k)},{name}/image-{k}.png")
    (log / "times.csv").write_text("\n".join(lines))
    (folder,) = recorder("times=times.csv", log=log).record(tmp_path)
    assert np.array_equal(SceneReader(folder).world_from_ego, original.world_from_ego)
    names = ", ".join(f"{name}: {log / name}/*.png" for name in original.rig.names)
    (again,) = recorder("times=times.csv", f"cameras={{{names}}}", log=log).record(tmp_path / "absolute")
    assert np.array_equal(SceneReader(again).images(0), SceneReader(folder).images(0))
    (log / "times.csv").write_text("\n".join(lines[:-1]))
    with pytest.raises(DataError, match=r"image-\d+.png: the CSV of times does not list it"):
        recorder("times=times.csv", log=log).record(tmp_path / "other")


def test_a_stop_before_the_name_is_given_leaves_no_scene(recorder, original, tmp_path, monkeypatch):
    def stopped(*given):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("omniocc.extras.recorders.log_scene.finish_scene", stopped)
        with pytest.raises(KeyboardInterrupt):
            recorder().record(tmp_path)
    assert list_folders(tmp_path, "frames-000.tar") == []
    (folder,) = recorder().record(tmp_path)
    assert len(SceneReader(folder)) == len(original)


def test_missing_frames_are_listed(recorder, original, log_folder, tmp_path, capsys):
    log = shutil.copytree(log_folder, tmp_path / "log")
    first_image(log, original).unlink()
    (folder,) = recorder(lidar_option("npz"), log=log).record(tmp_path)
    scene = SceneReader(folder)
    assert len(scene) == len(original) - 1
    (missing,) = scene.meta["facts"]["missing"]
    assert missing == {"time_s": stamp_ns(original, 1) / 1e9, "lacks": [original.rig.names[1]]}
    assert np.array_equal(scene.world_from_ego[0], original.world_from_ego[0])
    told = capsys.readouterr().err
    assert f"1 of {len(original)} frames are left out" in told
    assert f"nothing from {original.rig.names[1]}" in told


def test_frames_in_gaps_of_poses_and_scans_are_left_out(recorder, original, log_folder, tmp_path):
    log = shutil.copytree(log_folder, tmp_path / "log")
    for path in sorted((log / "bin").glob("*.bin"))[1:]:
        path.unlink()
    (folder,) = recorder(lidar_option("bin"), log=log).record(tmp_path)
    assert len(scene := SceneReader(folder)) == 1
    assert spec_of(scene).frame_interval_s > 0  # none can be measured, but what reads the scene needs one
    lines = (log / "poses.csv").read_text().splitlines()
    (log / "poses.csv").write_text("\n".join(lines[:2]))
    scene = SceneReader(recorder(log=log, name="val-000-own").record(tmp_path)[0])
    assert len(scene) == 1
    assert [entry["lacks"] for entry in scene.meta["facts"]["missing"]] == [["poses"]] * (len(original) - 1)


def test_the_own_car_is_left_out(recorder, tmp_path):
    box = "own_car_m: [[-4, -2, -3], [4, 2, 3]]"
    scene = record(recorder, tmp_path, lidar_option("npz", box))
    points = scene.points(0).points_m
    assert len(points)
    assert not (np.abs(points) < (3.99, 1.99, 2.99)).all(1).any()


def test_classes_of_a_logs_own(recorder, log_folder, original, tmp_path):
    log = shutil.copytree(log_folder, tmp_path / "log")
    rows = [f"{row.id}: way" if row.id < 4 else f"{row.id}: thing" for row in WORLD_CLASSES.rows if row.id > 1]
    (log / "classes.yaml").write_text("\n".join(["1: {name: way, rgb: [1, 2, 3]}", *rows, "255: unknown"]))
    (folder,) = recorder(lidar_option("npz", CLASSES), log=log).record(tmp_path)
    scene = SceneReader(folder)
    classes = spec_of(scene).classes
    assert classes.names == ("free", "way", "thing")
    assert classes.rows[1].rgb == (1, 2, 3)
    ours, theirs = np.sort(scene.points(0).labels), original.points(0).labels
    expected = np.where(theirs == UNKNOWN, UNKNOWN, np.where(theirs < 4, 1, 2))
    assert np.array_equal(ours, np.sort(expected))


def test_exported_poses_of_predict_are_read_back_alike(tmp_path):
    """The CSV of `predict.py` has names for times; with numbers as names both readers give the same poses."""
    from omniocc.extras.recorders.poses import read_timed_poses

    path = tmp_path / "poses.csv"
    path.write_text("frame,x_m,y_m,z_m,qw,qx,qy,qz\n3,1,2,3,0.6,0,0,0.8\n7,4,5,6,1,0,0,0\n")
    found = read_timed_poses(path, "csv", "s")
    assert found.times_s.tolist() == [3, 7]
    np.testing.assert_allclose(found.poses, read_poses(path, ["3", "7"]).numpy(), atol=1e-15)


def test_an_origin_beside_the_cameras_is_told():
    rig = Rig.load("fisheye6")
    assert origin_lines(rig) == []
    rear_axle = rig.ego_from_camera.clone()
    rear_axle[:, 0, 3] += 1.4
    (line,) = origin_lines(replace(rig, ego_from_camera=rear_axle))
    assert line.startswith("the middle of the cameras is 1.4 m ahead of the ego origin and 0.0 m to its left")


def test_rays_that_did_not_come_back_are_nowhere_in_a_recording(recorder, log_folder, tmp_path):
    """The LiDAR is 0.93 m from the ego origin: there (0, 0, 0) of its frame would be a point."""
    log = shutil.copytree(log_folder, tmp_path / "log")

    def with_lost(points, labels):
        lost = np.array([[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0]], np.float32)
        return np.concatenate([lost, points]), np.concatenate([[np.nan, np.nan, 3.6], labels])

    rewrite(log, with_lost)
    whole = record(recorder, tmp_path / "whole", NPZ)
    found = SceneReader(recorder(NPZ, log=log).record(tmp_path / "lost")[0])
    for frame in range(len(whole)):
        for ours, theirs in zip(found.points(frame), whole.points(frame), strict=True):
            np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(found.erp_range_m(frame), whole.erp_range_m(frame))
        np.testing.assert_array_equal(found.camera_range_m(frame), whole.camera_range_m(frame))


def test_images_are_what_the_sensor_saw(recorder, original, log_folder, tmp_path):
    log = tmp_path / "log"
    shutil.copytree(log_folder, log)
    path = sorted((log / original.rig.names[0]).iterdir())[0]
    image, exif = original.images(0)[0], Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(image).save(path, exif=exif)
    with recorder(log=log).open() as opened:
        plain = opened.inputs
        assert np.array_equal(opened.read_image(0, 0)[0], image)
    ramp = np.linspace(0, 4095, image[..., 0].size).round().astype(np.uint16).reshape(image.shape[:2])
    cv2.imwrite(str(path), ramp)
    with (
        recorder(log=log).open() as opened,
        pytest.raises(DataError, match=rf"{path.name}: .* reach 4095.*set recorder\.image_bits=12"),
    ):
        opened.read_image(0, 0)
    with recorder("image_bits=12", log=log).open() as opened:
        assert np.array_equal(opened.read_image(0, 0)[0][..., 1], (ramp * (255 / 4095)).round())
        assert set(map(str, opened.inputs)) - set(map(str, plain)) >= {"recorder.image_bits=12"}
    with pytest.raises(ValueError, match=r"recorder\.image_bits is 7; it must be 8 to 16"):
        recorder("image_bits=7", log=log)


def test_a_turn_of_the_lidar_is_corrected_unless_the_scans_are(recorder, original, log_folder, tmp_path, capsys):
    """Points of the first scan have times after its stamp: each moves with the car from its time to the frame's."""
    log = shutil.copytree(log_folder, tmp_path / "log")
    file = log / "npz" / f"{stamp_ns(original, 0)}.npz"
    arrays = dict(np.load(file))
    late_s = np.linspace(0.0, 0.1, len(arrays["points"]))
    np.savez(file, t=(late_s * 1e9).astype(np.uint32), **arrays)
    kept = SceneReader(recorder(lidar_option("npz", "deskew: false"), log=log).record(tmp_path / "kept")[0])
    assert "within a turn" not in capsys.readouterr().err
    turned = SceneReader(recorder(lidar_option("npz"), log=log).record(tmp_path / "turned")[0])
    assert "the car's motion within a turn of the LiDAR is corrected" in capsys.readouterr().err
    begin, end = original.world_from_ego[:2]
    step_m = (np.linalg.inv(begin) @ end)[:3, 3] * 0.1 / (original.time_s[1] - original.time_s[0])
    assert np.linalg.norm(step_m) > 0.1
    moved_m, _ = cKDTree(kept.points(0).points_m).query(turned.points(0).points_m)
    assert np.median(moved_m) > 0.01
    assert not np.array_equal(kept.points(0).points_m, turned.points(0).points_m)
    assert np.array_equal(kept.points(1).points_m, turned.points(1).points_m)  # its scan has no times
    moved_m = turned.scan(0).origins[0] - kept.scan(0).origins[0]
    assert np.allclose(moved_m, step_m / 2, atol=5e-3), "in the middle of the turn"
