"""A rendered scene, written as a log by py123d's own writer and recorded from it, is the same scene."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from kitti_files import write_kitti360
from log_files import built
from scipy.spatial import cKDTree
from scripts import run_script

from omniocc.camera import MEI, Pinhole
from omniocc.classes import OCCUPANCY_CLASSES, UNKNOWN, WORLD_CLASSES
from omniocc.config import build
from omniocc.data import DataError, SceneReader
from omniocc.data.formats.dataset_scene import outside
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.check import check_scene
from omniocc.errors import UserError
from omniocc.extras.recorders.py123d import INSTALL

pytest.importorskip("py123d", reason=INSTALL)

from py123d_files import (
    CAR_M,
    LABELS,
    LIDAR_M,
    RIG,
    SCANS_US,
    START_US,
    camera_metadata,
    convert_kitti360,
    frame_of,
    write_py123d,
)

from omniocc.extras.recorders import py123d_reader

NAMES = ("fmcam_l", "ftcam_l0", "pcam_b0", "pcam_r0")


@pytest.fixture(scope="session")
def drive(composed, tmp_path_factory) -> SceneReader:
    """Return a rendered scene of the rig that has every lens of the library."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "rig.yaml").write_text(RIG)
    options = f"data.source.rig={folder / 'rig.yaml'}", f"paths.data={folder}", "data.source.workers=0"
    world = build(composed("preset=smoke", *options).data.source)
    world.prepare(world.plans[:1])
    return world.reader(world.plans[0])


@pytest.fixture(scope="session")
def log(drive, tmp_path_factory):
    return write_py123d(drive, tmp_path_factory.mktemp("py123d"))


@pytest.fixture
def record(log, tmp_path):
    def make(*overrides: str, folder=log, name="train-000-town") -> SceneReader:
        (made,) = built("py123d", f"name={name}", f"log={folder}", *overrides).record(tmp_path / "recorded")
        return SceneReader(made)

    return make


def points_of(drive, frame):
    """Return the points that are not in the box of the own car, and their classes by the library."""
    points, (length, width, height) = drive.points(frame), CAR_M
    low = np.array([-length / 2, -width / 2, drive.rig.road_z_m])
    kept = outside(points.points_m, low, low + np.array([length, width, height]))
    assert 100 < (~kept).sum() < 20_000
    ids = np.array([0, *(int(LABELS[name].to_default()) or UNKNOWN for name in WORLD_CLASSES.names[1:])])
    return points.points_m[kept], ids[points.labels[kept]]


def test_a_recorded_log_is_the_scene_that_was_written(drive, record):
    scene = record()
    assert len(scene) == len(drive) == 2
    assert check_scene(scene, len(drive), 0.5) == []
    np.testing.assert_allclose(scene.time_s, drive.time_s, atol=1e-6)
    np.testing.assert_allclose(scene.world_from_ego, drive.world_from_ego, rtol=0, atol=1e-9)
    assert scene.rig.names == NAMES
    assert scene.rig.road_z_m == pytest.approx(drive.rig.road_z_m, abs=1e-9)
    torch.testing.assert_close(scene.rig.ego_from_camera, drive.rig.ego_from_camera, rtol=0, atol=1e-9)
    for ours, theirs in zip(scene.rig.cameras, drive.rig.cameras, strict=True):
        if not (isinstance(theirs, MEI) and theirs.xi == 0):
            assert ours == theirs
    for frame in range(len(drive)):
        for number in (0, 1, 3):
            apart = np.abs(scene.images(frame)[number].astype(int) - drive.images(frame)[number])
            assert apart.mean() < 2  # JPEG twice
    facts = scene.meta["facts"]
    assert facts["log"]["dataset"] == "virtual"
    assert (facts["start_s"], facts["missing"], facts["boxes"]) == (START_US / 1e6, [], True)


@pytest.mark.parametrize("dataset", SCANS_US)
def test_points_have_the_librarys_classes_and_none_is_of_the_own_car(drive, record, dataset, tmp_path):
    # the car drives, so a scan that is taken for earlier or later has other points
    scene = record(folder=write_py123d(drive, tmp_path, dataset=dataset))
    table = spec_of(scene).classes
    assert table.names[:4] == ("free", "vehicle", "two_wheeler", "person")
    assert table.num_classes == 13
    for frame in range(len(drive)):
        expected_m, expected = points_of(drive, frame)
        ours = scene.points(frame)
        apart_m, place = cKDTree(expected_m).query(ours.points_m)
        assert len(ours.points_m) == len(expected_m)
        assert apart_m.max() < 0.02  # points are stored in steps of 1/128 m
        assert (ours.labels == expected[place]).mean() > 0.99
        assert {1, 5, 9, UNKNOWN} <= set(ours.labels.tolist())
    np.testing.assert_allclose(scene.scan(0).origins[0], LIDAR_M, atol=1e-6)


def test_without_classes_points_are_occupied(drive, record, tmp_path):
    asked = record("classes=false")
    stated = record(folder=write_py123d(drive, tmp_path, labels=None), name="train-001")
    for scene in (asked, stated):
        assert spec_of(scene).classes == OCCUPANCY_CLASSES
        assert set(scene.points(0).labels.tolist()) == {1}
        assert {box.label for box in frame_of(scene, 0).boxes} == {1}
        assert scene.scan(0).moving.any()


def test_boxes_are_those_of_the_actors_at_the_time_of_the_scan(drive, record):
    # written 10 ms earlier, where the actors were at that time
    scene, low = record(), record("origin_above_road_m=1.5", name="train-001")
    names = spec_of(scene).classes.names
    for frame in range(len(drive)):
        ours, theirs = frame_of(scene, frame).boxes, frame_of(drive, frame).boxes
        assert len(ours) == len(theirs) > 10
        for one, other, moved in zip(ours, theirs, frame_of(low, frame).boxes, strict=True):
            np.testing.assert_allclose(one.center_m, other.center_m, rtol=0, atol=1e-6)
            np.testing.assert_allclose(one.size_m, other.size_m)
            assert np.cos(one.yaw_rad - other.yaw_rad) > 1 - 1e-9
            np.testing.assert_allclose(one.velocity_mps, other.velocity_mps, rtol=0, atol=1e-6)
            assert names[one.label] == {"Vehicle": "vehicle", "Pedestrian": "person"}[WORLD_CLASSES.names[other.label]]
            # the road is 2.0 m below the middle of the cameras
            np.testing.assert_allclose(moved.center_m, np.add(one.center_m, (0, 0, 0.5)), rtol=0, atol=1e-6)
            assert np.cos(moved.yaw_rad - one.yaw_rad) > 1 - 1e-9
    scan = scene.scan(0)
    moving = set(scan.labels[scan.moving].tolist())
    assert moving <= {names.index("vehicle"), names.index("person")}
    assert moving
    assert record("boxes=false", name="train-002").scan(0).moving is None


def test_scans_without_boxes_are_left_out(record):
    with pytest.raises(UserError, match=r"boxes: none is within limit_s=0\.005 .* boxes=false"):
        record("limit_s=0.005")  # boxes are 10 ms away
    assert len(record("limit_s=0.005", "boxes=false", "cameras=[fmcam_l, ftcam_l0]")) == 2


def test_a_distorted_pinhole_is_straightened(drive, record):
    scene, given = record(), drive.rig.cameras[2]
    ours = scene.rig.cameras[2]
    assert ours == Pinhole(64, 36, (25.0, 25.0), (31.5, 17.5))
    maps = py123d_reader.straightened(camera_metadata("rear", given, np.eye(4))).maps
    pixels = torch.stack(torch.meshgrid(torch.arange(64.0), torch.arange(36.0), indexing="xy"), -1).double()
    there, _ = given.project(ours.unproject(pixels)[0])
    np.testing.assert_allclose(maps.transpose(1, 2, 0), there.numpy(), atol=1e-4)
    # a ray through both lenses has the same colour
    image, original = scene.images(0)[2], drive.images(0)[2]
    column, row = there.round().long().unbind(-1)
    inside = (column >= 0) & (column < 64) & (row >= 0) & (row < 36)
    apart = np.abs(image[inside].astype(int) - original[row[inside], column[inside]]).mean()
    assert apart < 8 < np.abs(image.astype(int) - original).mean()


def test_pixels_that_no_image_shows_are_masked():
    # with pincushion distortion the straight image reaches beyond the one of the file
    given = MEI(64, 36, (25.0, 25.0), (31.5, 17.5), 0.0, (0.2, 0.0, 0.0, 0.0), 180.0)
    seen = py123d_reader.straightened(camera_metadata("rear", given, np.eye(4))).seen
    assert seen[18, 32]
    assert not seen[0, 0]


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_lenses_project_as_the_librarys(drive, number):
    name, camera = drive.rig.names[number], drive.rig.cameras[number]
    if isinstance(camera, MEI):
        camera = replace(camera, distortion=(*camera.distortion[:2], 0.0, 0.0))  # of MEI it takes the radial part
    view = camera_metadata(name, camera, np.eye(4))
    points = torch.randn(2000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    points[:, 2] = points[:, 2].abs() + 0.2
    expected, _, _ = view.project_to_image(points.numpy())
    pixels, seen = camera.project(points)
    assert seen.sum() > 300
    np.testing.assert_allclose(pixels[seen], expected[seen], rtol=0, atol=1e-6)


def test_mistakes_are_named(log, record, tmp_path):
    with pytest.raises(UserError, match="cameras: pcam_l0, but the log has fmcam_l, ftcam_l0"):
        record("cameras=[pcam_l0]")
    with pytest.raises(UserError, match=r"lidar=lidar_top: choose one .* lidar_merged"):
        record("lidar=lidar_top")
    with pytest.raises(UserError, match=r"there is no sync\.arrow"):
        record(folder=tmp_path)
    cut = tmp_path / "cut"
    cut.mkdir()
    for path in log.iterdir():
        (cut / path.name).write_bytes(path.read_bytes())
    (cut / "lidar.lidar_merged.arrow").write_bytes((log / "lidar.lidar_merged.arrow").read_bytes()[:5000])
    with pytest.raises(DataError, match=r"lidar\.lidar_merged\.arrow: it cannot be read"):
        record(folder=cut)
    for name in ("ego_state_se3", "lidar.lidar_merged"):
        (cut / f"{name}.arrow").unlink()
    with pytest.raises(DataError, match="has no poses"):
        record(folder=cut)


def test_a_log_imports_no_module_but_the_librarys(log, record, tmp_path):
    import msgpack
    import pyarrow

    folder = tmp_path / "hostile"
    folder.mkdir()
    for path in log.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    (tmp_path / "evil.py").write_text("raise SystemExit('imported')")
    path = folder / "lidar.lidar_merged.arrow"
    table = pyarrow.ipc.open_file(path).read_all()
    metadata = msgpack.unpackb(table.schema.metadata[b"metadata"], strict_map_key=False)
    metadata["2"]["segmentation_label_class"] = "evil.Labels"
    schema = table.schema.with_metadata({b"metadata": msgpack.packb(metadata)})
    with pyarrow.ipc.new_file(path, schema) as writer:
        writer.write_table(table.replace_schema_metadata(schema.metadata))
    sys.path.insert(0, str(tmp_path))
    try:
        with pytest.raises(DataError, match=r"lidar_merged\.arrow: its labels are of the class 'evil.Labels'"):
            record(folder=folder)
    finally:
        sys.path.remove(str(tmp_path))
    assert "evil" not in sys.modules


@pytest.mark.slow
def test_kitti360_by_the_library_is_kitti360_by_our_own_reader(composed, record, tmp_path):
    """The library's parser and `data=kitti360` read the same files; this holds its frames and times against ours."""
    root = write_kitti360(tmp_path / "kitti360", sequences=("00",), frames=3, offset=0)
    scene = record("image_size=[352,352]", folder=convert_kitti360(root, tmp_path))
    options = "data.source.frame_step=1", "data.source.sequences={train: ['00'], val: [], test: []}"
    options += ("data.source.cameras=[image_02,image_03,image_00]",)
    source = build(composed("preset=smoke", "data=kitti360", f"data.source.root={root}", *options).data.source)
    source.prepare()
    (ours,) = source.scenes("train")
    assert len(scene) == len(ours) == 2
    np.testing.assert_allclose(scene.world_from_ego, ours.world_from_ego, rtol=0, atol=1e-5)
    assert scene.rig.names == ("fmcam_l", "fmcam_r", "pcam_stereo_l", "pcam_stereo_r")
    torch.testing.assert_close(scene.rig.ego_from_camera[:3], ours.rigs[0].ego_from_camera, rtol=0, atol=1e-5)
    for frame in range(2):
        apart_m, _ = cKDTree(ours.cloud(frame).points_m).query(scene.points(frame).points_m)
        assert apart_m.max() < 0.02


@pytest.mark.whole_runs
@pytest.mark.slow
def test_a_log_is_recorded_trained_on_predicted_and_scored(log, tmp_path):
    def run(script, *arguments):
        done = run_script(script, *arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    for name in ("train-000", "val-000", "test-000"):
        given = "recorder=py123d", f"recorder.log={log}", f"recorder.name={name}", "recorder.origin_above_road_m=2.2"
        said = run("record.py", *given, "output=scenes")
    assert "data.num_classes=13" in said
    data = "data=recorded", "data.source.root=scenes", "data.num_classes=13", "data.ignore=unobserved"
    steps = [f"stages.{stage}.max_steps=2" for stage in ("depth", "sketch", "occupancy")]
    run("train.py", "preset=smoke", *data, *steps, "trainer.accelerator=cpu", "logger.mode=disabled")
    (run_folder,) = tmp_path.glob("runs/train-*")
    scores = json.loads((run_folder / "metrics.json").read_text())["metrics"]
    assert {"test/rayiou", "test/rayiou/vehicle", "test/depth/mae"} <= set(scores)
    assert scores["label/voxel/iou"] == 1.0
    (checkpoint,) = run_folder.glob("**/best.ckpt")
    run("predict.py", "occupancy", f"checkpoint={checkpoint}", "recorded=scenes/test-000", "output=out", "mesh=false")
    labels = np.load(tmp_path / "out" / "test-000" / "000001" / "voxels.npz")["labels"]
    assert set(np.unique(labels)) <= {*range(13), UNKNOWN}
    predicted = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert 0 <= predicted["metrics"]["test/rayiou"] <= 1
