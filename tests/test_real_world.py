"""Real frames are read from what lies in a folder, and scored by rays, by a cloth and by things on the road."""

import json
import math
import pickle

import cv2
import numpy as np
import pytest
import real_frames
import real_world
import torch
from numpy.testing._private.utils import runstring

from omniocc.camera import Pinhole, Rig
from omniocc.data.formats.kitti360 import velodyne_pose
from omniocc.data.source import kitti360
from omniocc.errors import DataError, UserError
from omniocc.geometry import Cuboid, Cylinder

RIG, GRID = Rig.load("surround_view"), Cylinder((64, 100, 8), (0.0, 25.6), (-1.516, 4.884))
"""The car with the cloth; a grid whose road is as high in its layer as in the weights that come with the package."""


@pytest.fixture
def cloth(tmp_path):
    """Return the frame of four grey images of the surround view."""
    for name in RIG.names:
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((640, 960, 3), 128, np.uint8))
    return real_frames.read_folder(tmp_path)[0]


def wall_frame():
    """Return a frame with a LiDAR 2 m above a road, points on it, and a wall 10 m ahead."""
    road_m = [(x, y, -2.0) for x in np.arange(3.25, 9, 0.5) for y in (-0.75, -0.25, 0.25, 0.75)]
    wall_m = [(10.25, y, z) for y in (-0.75, -0.25, 0.25, 0.75) for z in (-1.25, -0.75, -0.25)]
    pose = torch.tensor([[[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]], dtype=torch.float64)
    rig = Rig((Pinhole(200, 200, (60.0, 60.0), (99.5, 99.5)),), pose, ("front",), None, -2.0)
    points_m = torch.tensor(road_m + wall_m, dtype=torch.float64)
    classes = torch.tensor([1] * len(road_m) + [5] * len(wall_m), dtype=torch.uint8)
    return real_frames.RealFrame("wall", rig, [], points_m, classes, torch.zeros(3, dtype=torch.float64))


FINE = Cuboid((60, 8, 8), (0.0, 30.0), (-2.0, 2.0), (-2.25, 1.75))
SEEN = torch.ones(FINE.shape, dtype=torch.bool)


def test_true_voxels_have_the_best_scores_by_rays():
    frame = wall_frame()
    found = real_world.ray_scores(FINE.voxelize(frame.points_m, frame.labels), FINE, frame, SEEN)
    assert [found[key] for key in ("RayIoU", "without classes", "road", "standing", "IoU", "rayiou/5")] == [1] * 6
    assert found["rays"] == len(frame.points_m)
    assert math.isnan(found["17-25.6 m"])


def test_a_flat_road_hits_the_road_and_goes_through_the_wall():
    frame = wall_frame()
    road = real_world.road_layer(FINE, -2.0)
    assert road == 0
    flat = real_world.ruled((torch.arange(8) == road).expand(FINE.shape), road)
    found = real_world.ray_scores(flat, FINE, frame, SEEN)
    assert (found["road"], found["standing"], found["rayiou/1"]) == (
        1,
        0,
        pytest.approx(48 / 56),
    )  # 8 of 12 hit it behind
    assert found["RayIoU"] == pytest.approx(found["rayiou/1"] / 2)
    assert "RayIoU" not in real_world.ray_scores(flat, FINE, frame._replace(labels=None), SEEN)


def test_cells_that_no_camera_sees_or_no_ray_crosses_do_not_count():
    frame = wall_frame()
    true = FINE.voxelize(frame.points_m, frame.labels)
    behind = true.clone()
    behind[25:] = 4
    assert real_world.ray_scores(behind, FINE, frame, SEEN)["IoU"] == 1
    before = true.clone()
    before[15, 3:5, 2] = 4
    assert real_world.ray_scores(before, FINE, frame, SEEN)["IoU"] < 1
    seen = SEEN.clone()
    seen[15] = False
    assert real_world.ray_scores(before, FINE, frame, seen)["IoU"] == 1


def test_classes_follow_the_names_and_height_decides_without_a_network():
    ids = np.array([0, 1, 2, 3, 255])
    assert real_frames.as_world(("unoccupied", "car", "Roadline", "moon"), ids).tolist() == [0, 7, 1, 8, 255]
    assert real_frames.as_world(real_world.WORLD_CLASSES.names, np.arange(12)).tolist() == [*range(11), 1]
    assert real_world.ruled(torch.ones(1, 1, 3, dtype=torch.bool), 1).flatten().tolist() == [1, 1, 4]


def test_the_cloth_lies_on_the_road_and_things_stand_around_it(cloth):
    feet_m = real_frames.foot_points(RIG)
    assert feet_m[:, 2].tolist() == pytest.approx([-0.916] * 12)
    assert not real_frames.on_cloth(feet_m).any()
    assert feet_m.norm(dim=-1).min() > 4
    assert feet_m.norm(dim=-1).max() < 18
    assert cloth.standing.sum() == 12
    points_m = torch.tensor([[0.0, 0.0, -0.9], [3.0, 0.0, -0.9], [0.0, 2.0, -0.9], [6.0, 0.0, -0.9]])
    assert real_frames.on_cloth(points_m).tolist() == [False, True, True, False]


def test_voxels_on_the_cloth_and_things_are_found_and_chance_is_told(cloth):
    road, seen = real_world.road_layer(GRID, cloth.road_z_m), torch.ones(GRID.shape, dtype=torch.bool)
    on_it = real_frames.on_cloth(GRID.centers())
    flat = real_world.ruled((torch.arange(8) == road) & on_it, road)
    found = real_world.cloth_scores(flat, GRID, cloth, seen)
    assert list(found.values()) == [1, 1, 0, 0, 0]
    flat[GRID.index(real_frames.foot_points(RIG) + torch.tensor([0.0, 0.0, 1.4]))[0].unbind(-1)] = 7
    found = real_world.cloth_scores(flat, GRID, cloth, seen)
    assert found["things"] == 12
    assert 0 < found["by chance"] < 4
    flat[..., road + 1] = 4
    flat[..., road] = 2
    assert list(real_world.cloth_scores(flat, GRID, cloth, seen).values()) == [1, 0, 1, 12, 12]


def test_ranges_are_compared_by_kind_of_point():
    points_m = torch.tensor([[4.0, 0, -2.0], [10.0, 0, -2.0], [0, 10.0, 0.5], [0, -20.0, 0.5]]).double()
    frame = wall_frame()._replace(points_m=points_m)
    found = real_world.range_scores(points_m.norm(dim=-1) * torch.tensor([1.05, 1.2, 0.7, torch.nan]), frame)
    assert found["road"][:4] == [2, 1, 0.5, 1]
    assert found["standing"] == [2, 0.5, 0, 0, pytest.approx(0.3)]
    assert found["0-8.5 m"][:4] == [1, 1, 1, 1]
    assert found["17-25.6 m"][:4] == [1, 0, 0, 0]


def test_folders_of_no_kind_and_of_two_kinds_are_named(tmp_path):
    with pytest.raises(UserError, match=f"{tmp_path} is of no known kind"):
        real_frames.read_folder(tmp_path)
    for name in ("front.png", "a_depth.png"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(UserError, match="exactly one kind"):
        real_frames.read_folder(tmp_path)


@pytest.mark.parametrize(
    "content", [pickle.dumps(pytest.raises), pickle.dumps(runstring), pickle.dumps({"data_list": [3]}), b"no pickle"]
)
def test_pickles_that_name_code_or_are_damaged_are_refused_by_name(content, tmp_path):
    (tmp_path / "a.pkl").write_bytes(content)
    (tmp_path / "x_LIDAR_TOP_.bin").write_bytes(b"")
    with pytest.raises(UserError, match=r"a\.pkl is not as expected: [^\n]+$"):
        real_frames.read_folder(tmp_path)


def test_arrays_and_numbers_are_read(tmp_path):
    kept = {"pose": np.eye(4), "time": np.float64(0.5), "name": "a"}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(kept, protocol=2))
    with (tmp_path / "a.pkl").open("rb") as file:
        found = real_frames.PlainUnpickler(file).load()
    assert (found["pose"] == np.eye(4)).all()
    assert (found["time"], found["name"]) == (0.5, "a")


@pytest.mark.whole_runs
def test_the_command_prints_tables_and_keeps_the_figures(cloth, tmp_path, capsys):
    real_world.main([str(tmp_path), "--checkpoints", "tiny-depth", "--write", str(tmp_path / "figures.json")])
    figures = json.loads((tmp_path / "figures.json").read_text())["surround view"]
    assert list(figures["voxels"][0]) == [
        "a flat road",
        *(f"ranges of {n} as cells" for n in ("any-rig", "tiny-depth")),
        "any-rig",
    ]
    assert list(figures["ranges"]) == ["a flat road", "any-rig", "any-rig, not told the height", "tiny-depth"]
    assert figures["ranges"]["a flat road"]["road"][1:] == pytest.approx([1, 1, 1, 0], abs=1e-6)
    assert figures["ranges"]["a flat road"]["standing"][:4] == [12, 1, 0, 0]
    printed = capsys.readouterr().out
    assert "| a flat road | 1.000 | 1.000 | 0.000 | 0.000 | 0.000 |" in printed
    assert "| any-rig, not told the height | standing | 12 |" in printed


def test_a_flat_road_is_near_most_points_of_real_roads(samples):
    (frame,) = real_frames.read_folder(samples / "nuscenes_demo")
    assert len(frame.images) == len(frame.rig.cameras) == 6
    assert frame.road_z_m == pytest.approx(-1.5, abs=0.1)
    assert real_world.range_rows(frame, {})["a flat road"]["road"][3] == pytest.approx(0.9, abs=0.005)


def test_classes_of_the_points_of_a_key_frame_are_read_where_they_are(samples, tmp_path):
    for path in (samples / "nuscenes_demo").iterdir():
        (tmp_path / path.name).symlink_to(path)
    np.tile(np.array([24, 31], np.uint8), 34_688 // 2).tofile(tmp_path / "a_lidarseg.bin")  # a road, and the own car
    (frame,) = real_frames.read_folder(tmp_path)
    assert set(frame.labels.tolist()) == {1, 255}


def test_points_of_a_real_street_have_classes_and_lie_in_view(samples):
    frames = real_frames.read_folder(samples / "semantickitti_mini")
    assert [len(frame.images) for frame in frames] == [1, 2, 1]
    for frame in frames:
        road_m = frame.points_m[frame.labels == 1]
        assert (road_m[:, 2] - frame.road_z_m).abs().median() < 0.1
        assert set(frame.labels.tolist()) == {1, 2, 4, 5, 6, 7, 9, 10, 255}


def test_the_real_fisheye_is_the_left_one(samples):
    (frame,) = real_frames.read_folder(samples / "kitti360_fisheye")
    calibration = samples / "kitti360_calibration_rebuilt" / "calibration"
    ego_from_velodyne = torch.from_numpy(kitti360.ego_from_imu() @ velodyne_pose(calibration))
    away_m = (frame.points_m - frame.lidar_m) @ ego_from_velodyne[:3, :3]
    angle = torch.rad2deg(torch.atan2(away_m[:, 2], away_m[:, :2].norm(dim=-1)))
    counts = torch.histc(angle, 1400, -25.0, 3.0)
    assert counts.var() / counts.mean() > 12  # the LiDAR's rings are sharp; with the right fisheye it is 8


def test_damaged_files_of_samples_are_named(tmp_path):
    sample = tmp_path / "sample"  # folders beside it are read, too
    folder = sample / "sequences" / "00" / "image_2"
    folder.mkdir(parents=True)
    (folder / "000000.png").write_bytes(b"")
    (folder.parent / "calib.txt").write_text("P2: 1\n")
    with pytest.raises(DataError, match=r"calib\.txt, line 1"):
        real_frames.read_folder(sample)
