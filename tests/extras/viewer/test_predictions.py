"""Folders of `predict.py occupancy`, shown as they are, and the same frames while they are predicted."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from made_scenes import FRAMES, RIG, SCENES
from recordings import read

from omniocc.classes import UNKNOWN
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.reader import SceneReader
from omniocc.errors import UserError
from omniocc.extras.viewer.collect import open_shown
from omniocc.extras.viewer.command import show_frames
from omniocc.extras.viewer.options import TargetOptions, ViewOptions
from omniocc.extras.viewer.predictions import own_frames, predicted_frames
from omniocc.extras.viewer.timeline.sinks import to_file
from omniocc.extras.viewer.timeline.stream import RangeStream, VoxelStream
from omniocc.predict.depth import predict_panoramas
from omniocc.predict.export_scene import export_scene
from omniocc.predict.occupancy import options_of, predict_occupancy
from omniocc.predict.output.voxel_files import VOXELS

pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR")
QUICK = ("overview=false", "mesh=false")


@pytest.fixture(scope="module")
def predict(composed):
    def run(*overrides, show=None) -> None:
        predict_occupancy(options_of(composed(*map(str, overrides), *QUICK, name="predict_occupancy")), show)

    return run


@pytest.fixture(scope="module")
def of_scene(cylinder_run, dataset, tmp_path_factory, predict):
    """Return the folder of predictions for a recorded scene."""
    folder = tmp_path_factory.mktemp("predicted") / "occupancy"
    predict(f"checkpoint={cylinder_run / 'best.ckpt'}", f"recorded={dataset}", f"scene={SCENES[1]}", f"output={folder}")
    return folder


@pytest.fixture(scope="module")
def of_images(cylinder_run, dataset, tmp_path_factory, predict):
    """Return the folder of predictions for a user's own images, and the folder of these."""
    images = tmp_path_factory.mktemp("images") / "sequence"
    export_scene(dataset / SCENES[1], images)
    folder = images.parent / "own"
    source = f"images={images}", f"rig={images / 'rig.yaml'}", f"poses={images / 'poses.csv'}"
    predict(f"checkpoint={cylinder_run / 'best.ckpt'}", *source, f"output={folder}")
    return folder, images


def test_predictions_for_recorded_scenes_come_with_truth_and_figures(of_scene, cylinder_run):
    shown = open_shown(ViewOptions(predictions=str(of_scene)))
    live = open_shown(ViewOptions(run=[str(cylinder_run)]))
    assert shown.models == ("occupancy",)
    assert shown.grids == live.grids
    assert shown.frames == live.frames
    assert (shown.road_z_m, shown.frame_interval_s) == (live.road_z_m, live.frame_interval_s)
    for one, other in zip(shown, live, strict=True):
        (kept,), (computed,) = one.predictions.values(), other.predictions.values()
        assert torch.equal(kept.labels, computed.labels)
        assert torch.equal(kept.candidates, computed.candidates)
        assert kept.figures == computed.figures
        assert torch.equal(one.truth[shown.grids[0]], other.truth[shown.grids[0]])
        assert np.array_equal(one.images[0], other.images[0])
        assert one.time_s == other.time_s


def test_frames_come_in_the_order_of_their_numbers(tmp_path):
    for name in ("drive 10/9", "drive 2/10", "drive 2/9"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / VOXELS).touch()
    assert list(predicted_frames(tmp_path).items()) == [("drive 2", ["9", "10"]), ("drive 10", ["9"])]


def test_the_truth_is_that_of_the_training(make_run, dataset, predict, tmp_path):
    run = make_run("unobserved-0a1b2c3d", "data.ignore=unobserved")
    source = f"checkpoint={run / 'best.ckpt'}", f"recorded={dataset}", f"scene={SCENES[1]}", "frames=[0]"
    predict(*source, f"output={tmp_path / 'out'}")
    (kept,) = open_shown(ViewOptions(predictions=str(tmp_path / "out")))
    (computed,) = open_shown(ViewOptions(run=[str(run)], frames=[0]))
    for one in (kept, computed):
        (truth,) = one.truth.values()
        assert (truth == UNKNOWN).any()
    assert [one.figures for one in kept.predictions.values()] == [one.figures for one in computed.predictions.values()]


def test_scenes_that_are_gone_are_shown_without_images(of_scene, dataset, tmp_path):
    shutil.copytree(of_scene, tmp_path / "out")
    (tmp_path / "out" / SCENES[1]).rename(tmp_path / "out" / "test-999-gone")
    frames = list(open_shown(ViewOptions(predictions=str(tmp_path / "out"))))
    assert [frame.scene for frame in frames] == ["test-999-gone"] * FRAMES
    assert all(frame.images == () and frame.truth == {} for frame in frames)


def test_predictions_for_own_images_come_with_images_and_cameras(of_images, dataset):
    folder, _ = of_images
    shown = open_shown(ViewOptions(predictions=str(folder), frames=[0, 2]))
    assert shown.frames == (("", "000000"), ("", "000002"))
    frames = list(shown)
    recorded = SceneReader(dataset / SCENES[1])
    for frame, k in zip(frames, (0, 2), strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(frame.images, recorded.images(k), strict=True))
        assert frame.rig == replace(recorded.rig, road_z_m=spec_of(recorded).road_z_m)  # which the export states
        assert np.allclose(frame.world_from_ego, recorded.world_from_ego[k])
        assert frame.truth == {}
        assert frame.predictions["own"].figures == {}
        assert (frame.predictions["own"].labels > 0).any()


def test_predictions_are_shown_when_their_images_are_gone(of_images, tmp_path):
    folder, _ = of_images
    shutil.copytree(folder, tmp_path / "own")
    facts = json.loads((folder / "prediction.json").read_text())
    (tmp_path / "own" / "prediction.json").write_text(json.dumps({**facts, "images": "gone"}))
    frames = list(open_shown(ViewOptions(predictions=str(tmp_path / "own"))))
    assert len(frames) == FRAMES
    assert all(frame.images == () and frame.rig.names == RIG.names for frame in frames)
    show_frames(ViewOptions(predictions=str(tmp_path / "own")), TargetOptions(save=str(tmp_path / "v.rrd")))
    assert any(path.startswith("/world/ego/voxels/own/") for path in read(tmp_path / "v.rrd"))


def test_predictions_of_a_bag_are_shown_without_its_images(of_images, tmp_path):
    """Its folder holds no frames."""
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    assert own_frames({"images": str(tmp_path / "log")}, RIG) == {}
    assert own_frames({"images": str(of_images[1])}, RIG)


def test_folders_that_are_damaged_or_no_predictions_are_a_line(of_scene, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "unfinished").mkdir()
    shutil.copy(of_scene / "prediction.json", tmp_path / "unfinished")
    shutil.copytree(of_scene, tmp_path / "damaged")
    (tmp_path / "damaged" / SCENES[1] / "000000" / "voxels.npz").write_bytes(b"no zip")
    shutil.copytree(of_scene, tmp_path / "listed")
    (tmp_path / "listed" / "prediction.json").write_text("[")
    for name, words in (
        ("empty", "no predictions of predict.py occupancy"),
        ("unfinished", "no finished predictions"),
        ("damaged", "is damaged or no file of predict.py occupancy"),
        ("listed", "is damaged"),
    ):
        with pytest.raises(UserError, match=words) as caught:
            open_shown(ViewOptions(predictions=str(tmp_path / name)))
        assert "\n" not in str(caught.value)


def test_predictions_are_streamed_as_they_come(of_scene, cylinder_run, dataset, predict, tmp_path):
    source = f"checkpoint={cylinder_run / 'best.ckpt'}", f"recorded={dataset / SCENES[1]}", f"output={tmp_path / 'out'}"
    with to_file(tmp_path / "v.rrd", "title") as recording:
        predict(*source, show=VoxelStream(recording))
    found = read(tmp_path / "v.rrd")
    shown = list(open_shown(ViewOptions(predictions=str(of_scene))))
    curve = [float(row.array("Scalars:scalars")[0]) for row in found["/figures/rayiou/prediction"]]
    assert curve == [frame.predictions["occupancy"].figures["rayiou"] for frame in shown]
    assert len(found["/images/front"]) == FRAMES
    assert any(path.startswith("/world/ego/voxels/truth") for path in found)
    assert len(found["/ranges/prediction"]) == FRAMES


def test_own_images_are_streamed_without_truth(of_images, cylinder_run, predict, tmp_path):
    _, images = of_images
    source = f"images={images / '000000'}", f"rig={images / 'rig.yaml'}", f"output={tmp_path / 'out'}"
    with to_file(tmp_path / "v.rrd", "title") as recording:
        predict(f"checkpoint={cylinder_run / 'best.ckpt'}", *source, show=VoxelStream(recording))
    found = read(tmp_path / "v.rrd")
    assert any(path.startswith("/world/ego/voxels/prediction/") for path in found)
    assert not any("truth" in path or path.startswith("/figures") for path in found)
    assert "/world/trajectory" not in found


def test_ranges_are_streamed_as_they_come(of_images, composed, tmp_path):
    _, images = of_images
    overrides = [
        "checkpoint=sweep",
        "preset=smoke",
        f"images={images}",
        f"rig={images / 'rig.yaml'}",
        f"output={tmp_path / 'out'}",
    ]
    with to_file(tmp_path / "v.rrd", "title") as recording:
        predict_panoramas(composed(*overrides, name="predict_depth"), overrides, RangeStream(recording))
    found = read(tmp_path / "v.rrd")
    for k, row in enumerate(found["/ranges/prediction"]):
        range_m = np.load(tmp_path / "out" / f"{k:06d}" / "range.npz")["range_m"]
        codes = np.frombuffer(bytes(row.columns["DepthImage:buffer"][0]), np.uint16).reshape(range_m.shape)
        known = np.isfinite(range_m)
        assert np.allclose(codes[known] / 256, range_m[known], atol=1 / 256)
    assert len(found["/world/ego/points/prediction"]) == FRAMES


def test_predictions_for_one_scene_folder_come_with_truth_too(of_scene, cylinder_run, dataset, predict, tmp_path):
    predict(f"checkpoint={cylinder_run / 'best.ckpt'}", f"recorded={dataset / SCENES[1]}", f"output={tmp_path / 'out'}")
    shown, of_dataset = (open_shown(ViewOptions(predictions=str(path))) for path in (tmp_path / "out", of_scene))
    assert shown.frame_interval_s == of_dataset.frame_interval_s
    for one, other in zip(shown, of_dataset, strict=True):
        assert one.predictions["out"].figures == other.predictions["occupancy"].figures
        assert np.array_equal(one.images[0], other.images[0])
