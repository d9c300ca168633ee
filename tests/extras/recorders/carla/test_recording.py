"""Scenes recorded from the stand-in of a CARLA server beside the same captured directly; and what goes wrong."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scripts import run_script

from omniocc.camera import Rig
from omniocc.classes import NUM_CLASSES, UNKNOWN
from omniocc.data import SceneReader
from omniocc.data.labels.voxels import vote
from omniocc.data.source.recorded import Recorded
from omniocc.data.store.check import check_scene
from omniocc.geometry import Cylinder
from omniworld import Scene

pytestmark = pytest.mark.whole_runs

pytest.importorskip("carla", reason="the client of CARLA is not installed: pip install -e '.[carla]'")

STAND_IN = Path(__file__).with_name("stand_in.py")
SIZE = (128, 72)
OPTIONS = "scenes=1 maps=[Town01] frames=2 warm_up=2 panorama=[96,24,45,-45] lidars=20 timeout_s=60 load_s=300"
SMALL = tuple(f"recorder.{word}" for word in [*OPTIONS.split(), f"image_size=[{SIZE[0]},{SIZE[1]}]"])
FIRST_TICK = 5
"""Ticks until the first recorded frame: one for pedestrians, one for the sensors, two to warm up, its own."""


def record(folder, *overrides, kill_when=lambda: False, **options):
    options.setdefault("state", str(folder / "server.json"))
    given = [*SMALL, f"recorder.python='{sys.executable} {STAND_IN}'", f"output={folder / 'out'}", *overrides]
    variables = {"STAND_IN": json.dumps(options), "OMP_NUM_THREADS": "1"}
    return run_script("record.py", *given, cwd=folder, kill_when=kill_when, **variables)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("carla")
    result = record(folder)
    assert result.returncode == 0, result.stderr
    assert f"recorded  {folder / 'out'}" in result.stdout
    assert f"python src/check.py data=recorded data.source.root={folder / 'out'} 'data.source.splits=" in result.stdout
    return folder / "out"


@pytest.fixture(scope="module")
def scene(recorded):
    return SceneReader(recorded / "train-000-Town01")


@pytest.fixture(scope="module")
def direct():
    """The first frame as the virtual world captures it."""
    rig = Rig.load("fisheye6").resized(*SIZE)
    return Scene("downtown", 3, rig, supersample=1, weather="clear", erp_size=(96, 24)).frame(FIRST_TICK)


def test_scenes_are_whole_and_read_as_any_others(recorded, scene):
    assert check_scene(scene, 2, 0.1) == []
    source = Recorded(str(recorded), {"train": ["train-*"], "val": [], "test": []}, workers=0)
    source.prepare()
    assert [reader.name for reader in source.scenes("train")] == ["train-000-Town01"]
    facts = scene.meta["facts"]
    assert (facts["server"], facts["client"], facts["town"]) == ("0.9.16", "0.9.16", "Town01")
    assert facts["tags"]["Road"] == [1]
    assert source.spec.frame_interval_s == 0.1


def test_poses_are_those_of_the_drive(scene, direct):
    assert scene.time_s.tolist() == pytest.approx([0, 0.1])
    np.testing.assert_allclose(scene.world_from_ego[0], direct.world_from_ego, atol=1e-4)


def test_cubemaps_see_the_same_classes_and_ranges(scene, direct):
    semantics, range_m = np.stack(scene.pixel_labels(0)), np.stack(scene.camera_range_m(0))
    known = (semantics != UNKNOWN) & (direct.semantics != UNKNOWN)
    assert ((semantics == UNKNOWN) != (direct.semantics == UNKNOWN)).mean() < 0.01  # the own car is a box here
    assert (semantics == direct.semantics)[known].mean() > 0.93
    both = np.isfinite(range_m) & np.isfinite(direct.range_m)
    off = np.abs(range_m[both] - direct.range_m[both]) / direct.range_m[both]
    assert np.median(off) < 1e-3
    assert (off < 0.02).mean() > 0.88  # borders and far things fall on neighbouring pixels
    images = np.stack(scene.images(0)).astype(float)
    assert np.abs(images - direct.images)[known].mean() < 14


def test_ranges_around_the_ego_are_the_same(scene, direct):
    panorama, lidar = scene.erp_range_m(0), scene.lidar(0)
    pairs = (panorama, direct.erp_range_m, 0.78), (lidar.range_m, direct.lidar_range_m, 0.88)
    for found, true, least in pairs:
        both = np.isfinite(found) & np.isfinite(true)
        off = np.abs(found[both] - true[both]) / true[both]
        assert np.median(off) < 1e-3
        assert (off < 0.02).mean() > least
        assert np.isnan(found).mean() < 0.3  # rays onto the own car, which the virtual LiDAR does not see
    hit = np.isfinite(lidar.range_m) & np.isfinite(direct.lidar_range_m)
    assert (lidar.labels == direct.lidar_labels)[hit].mean() > 0.91


def test_voxels_are_the_same(scene, direct):
    """LiDARs stand elsewhere, so a few cells are seen by one alone: IoU .93, of the common cells 95 % in one class."""
    grid = Cylinder((64, 100, 8))
    found = vote(scene, 0, grid).numpy()
    points, labels = torch.from_numpy(direct.points_m), torch.from_numpy(direct.point_labels)
    true = grid.voxelize(points, labels, NUM_CLASSES).numpy()
    both, either = (found > 0) & (true > 0), (found > 0) | (true > 0)
    assert both.sum() / either.sum() > 0.9
    assert both.sum() / (true > 0).sum() > 0.96
    assert (found == true)[both].mean() > 0.93
    lines = (true == 11) & both
    assert (found == 11)[lines].mean() > 0.6  # the stand-in's LiDARs don't see them: they come from the images


def test_boxes_are_those_of_the_traffic(scene, direct):
    boxes = {box["id"] - 100: box for box in json.loads(scene.read(0, ["frame.json"])["frame.json"])["boxes"]}
    assert len(boxes) > 3
    for box in direct.boxes:
        if box.id in boxes:
            found = boxes[box.id]
            np.testing.assert_allclose(found["center_m"], box.center_m, atol=0.02)
            np.testing.assert_allclose(found["size_m"], box.size_m, atol=1e-3)
            np.testing.assert_allclose(found["velocity_mps"], box.velocity_mps, atol=0.01)
            assert found["label"] == box.label


def test_a_server_that_cannot_be_used_is_one_line(tmp_path):
    bare = run_script(
        "record.py", *SMALL, f"recorder.python='{sys.executable} -I -S'", f"output={tmp_path}", cwd=tmp_path
    )
    for result, message in (
        (record(tmp_path, nobody=True), "no CARLA server answers at localhost:2000 (time-out of 2000ms"),
        (
            record(tmp_path, version="0.9.15"),
            "the server is CARLA 0.9.15, this client 0.9.16; both must",
        ),
        (
            record(tmp_path, "recorder.weather=[Sunny]"),
            "recorder.weather: there is no weather Sunny; there are ClearNight, ClearNoon",
        ),
        (record(tmp_path, "recorder.maps=[Town99]"), "recorder.maps: there is no map Town99; this server has Town01,"),
        (record(tmp_path, "recorder.port=99999"), "port is 99999; ports are from 1 to 65535"),
        (bare, "this Python has no CARLA client (No module named 'carla'): pip install"),
    ):
        assert result.returncode == 1
        assert message in result.stderr
        assert "Traceback" not in result.stderr
        assert "begun again" not in result.stdout + result.stderr
        assert list(tmp_path.glob("**/train-000-Town01")) == []


def test_a_scene_of_other_options_is_not_taken_for_this_one(recorded):
    result = record(recorded.parent, "recorder.seed=3")
    assert result.returncode == 1
    assert "there is a scene recorded with other options" in result.stderr
    again = record(recorded.parent)
    assert (again.returncode, again.stderr) == (0, "")


@pytest.mark.faults
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        pytest.param("crash", "the capturing process was killed or crashed", marks=pytest.mark.whole_runs),
        ("hang", "the CARLA server has not answered for"),
        ("late", "sensor front/0/rgb sent nothing for 10 s"),
    ],
)
def test_a_scene_is_begun_again_after(fault, said, tmp_path, recorded):
    quick = () if fault == "crash" else ("recorder.timeout_s=10",)
    result = record(tmp_path, *quick, fault=fault, at=4, once=str(tmp_path / "over"))
    assert result.returncode == 0, result.stderr
    assert said in result.stdout
    assert "it is begun again" in result.stdout
    assert check_scene(SceneReader(tmp_path / "out" / "train-000-Town01"), 2, 0.1) == []
    assert json.loads((tmp_path / "server.json").read_text())["synchronous_mode"] is False


@pytest.mark.faults
def test_a_scene_that_fails_each_time_ends_the_recording(tmp_path):
    result = record(tmp_path, "recorder.attempts=2", "recorder.stuck_s=0.1", "recorder.frames=8", still=True)
    assert result.returncode == 1
    assert "scene train-000-Town01: localhost:2000: the ego vehicle has not moved for 0.1 s" in result.stderr
    assert not (tmp_path / "out" / "train-000-Town01").exists()


@pytest.mark.faults
def test_a_killed_recorder_leaves_nothing_that_is_read_as_whole(tmp_path):
    partial = tmp_path / "out" / "train-000-Town01.partial"
    shard = partial / "frames-000.tar"
    record(tmp_path, "recorder.frames=40", kill_when=lambda: shard.exists() and shard.stat().st_size > 0)
    assert partial.exists()
    assert not (tmp_path / "out" / "train-000-Town01").exists()
    assert json.loads((tmp_path / "server.json").read_text())["synchronous_mode"] is True
    result = record(tmp_path)
    assert result.returncode == 0, result.stderr
    assert len(SceneReader(tmp_path / "out" / "train-000-Town01")) == 2
    assert not partial.exists()
    assert json.loads((tmp_path / "server.json").read_text())["synchronous_mode"] is False


@pytest.mark.faults
@pytest.mark.parametrize(
    ("lie", "fails"),
    [
        ({}, ()),
        ({"depth_scale": 1.1}, ("depth",)),
        ({"mirror": True}, ("handedness",)),
        ({"tags": {"Road": 7, "Building": 1, "Vehicle": 10, "Pedestrian": 4}}, ("tags",)),
    ],
    ids=["as assumed", "depth", "mirrored", "tags of an old server"],
)
def test_a_check_finds_what_is_not_as_assumed(lie, fails, tmp_path):
    result = record(tmp_path, "check=true", **lie)
    failed = {line.split()[1].rstrip(":") for line in result.stdout.splitlines() if line.startswith("FAIL")}
    assert set(fails) <= failed
    assert bool(failed) == bool(fails) == bool(result.returncode)
    assert result.stdout.count("pass  ") + len(failed) == 6
