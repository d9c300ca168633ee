"""What is shown: compared with the model's own evaluation and with the metrics called frame by frame."""

import numpy as np
import pytest
import torch
from made_scenes import FRAMES, RIG, SCENES, make_frame

from omniocc.data.dataset import WindowDataset, collate
from omniocc.data.labels.voxels import VoxelCache
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.reader import SceneReader
from omniocc.errors import UserError
from omniocc.extras.viewer import collect
from omniocc.extras.viewer.collect import open_shown
from omniocc.extras.viewer.models import mask_labels
from omniocc.extras.viewer.options import ViewOptions, unique_names
from omniocc.extras.viewer.scenes import choose
from omniocc.metric import RayIoU, VoxelIoU
from omniocc.predict import load

pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR")


def evaluated(run, scene):
    """Return the labels that `evaluate.py` computes for a scene, with the true voxels."""
    task = load(run, [f"data.source.root={scene.parent}"]).task
    geometry = task.model.geometry
    labels = VoxelCache(scene.parent / "none", geometry)
    data = WindowDataset([SceneReader(scene)], labels, task.model.temporal.frames)
    batches = [collate([data[k]]) for k in range(len(data))]
    with torch.inference_mode():
        heads = [task.predict(batch).pixel_logits[0].argmax(1) for batch in batches]
    return geometry, [task.evaluate(batch)[0] for batch in batches], [b.voxels[0] for b in batches], heads


def test_runs_on_two_grids_side_by_side_show_what_their_tests_see(cylinder_run, cuboid_run, dataset):
    shown = open_shown(ViewOptions(run=[str(cylinder_run), str(cuboid_run / "best.ckpt")]))
    frames = list(shown)
    assert shown.models == ("ours-0a1b2c3d", "cuboid-4e5f6a7b")
    assert len(shown) == len(frames) == FRAMES
    assert [(frame.scene, frame.frame) for frame in frames] == list(shown.frames)
    assert shown.frames[0] == (SCENES[1], "000000")
    for run, grid in zip((cylinder_run, cuboid_run), shown.grids, strict=True):
        geometry, labels, truth, heads = evaluated(run, dataset / SCENES[1])
        assert grid == geometry
        assert len(torch.unique(torch.stack(labels))) > 3  # otherwise equality would prove nothing
        for k, frame in enumerate(frames):
            prediction = frame.predictions[run.name]
            assert prediction.grid == grid
            assert torch.equal(prediction.labels, labels[k])
            assert torch.equal(frame.truth[grid], truth[k])
            assert_figures(prediction.figures, labels[k], truth[k], grid, frame)
            inside = np.stack(prediction.pixel_labels) != 255
            assert np.array_equal(np.stack(prediction.pixel_labels)[inside], heads[k].numpy()[inside])
            assert np.array_equal(inside[0], np.broadcast_to((np.arange(9) * 4 + 2 < 30)[:, None], (9, 16)))
        assert max(frame.predictions[run.name].figures["rayiou"] for frame in frames) > 0


def assert_figures(figures, labels, truth, grid, frame):
    rays, cells = RayIoU(grid), VoxelIoU()
    rays.update(labels[None], truth[None])
    cells.update(labels[None], truth[None])
    expected = {key: rays.compute()[key] for key in ("rayiou", "rayiou@1", "rayiou@2", "rayiou@4")}
    expected |= {key: cells.compute()[key] for key in ("iou", "miou")}
    for key, value in expected.items():
        assert figures[key] == pytest.approx(float(value), nan_ok=True), key
    assert np.isfinite(figures["lidar/rayiou"])


def test_a_frame_holds_what_was_recorded(cylinder_run):
    shown = open_shown(ViewOptions(run=[str(cylinder_run)], frames=[2]))
    (frame,) = shown
    recorded = make_frame(12)
    assert frame.time_s == 6.0
    assert np.array_equal(frame.world_from_ego, recorded.world_from_ego)
    assert len(frame.images) == len(RIG.names)
    assert np.abs(frame.images[1].astype(int) - recorded.images[1]).mean() < 20  # JPEG
    assert frame.rig.names == RIG.names
    assert (frame.panorama.top_deg, frame.panorama.bottom_deg) == (45.0, -45.0)
    assert (frame.panorama.height, frame.panorama.width) == tuple(frame.range_m.shape) == (12, 48)
    assert np.allclose(frame.range_m.numpy(), recorded.erp_range_m, atol=0.01)
    assert np.array_equal(frame.lidar.labels, recorded.lidar_labels)
    prediction = frame.predictions["ours-0a1b2c3d"]
    assert prediction.candidates.shape == prediction.labels.shape
    assert prediction.range_m.shape == (prediction.panorama.height, prediction.panorama.width)
    assert tuple(shown.directions.shape) == (14040, 3)
    assert shown.road_z_m == spec_of(SceneReader(shown_scene(shown))).road_z_m


def shown_scene(shown):
    return f"{shown.source.removeprefix('test scenes of ').rpartition('/')[0]}/{shown.frames[0][0]}"


def test_a_frame_alone_has_the_history_of_all(cylinder_run):
    (alone,) = open_shown(ViewOptions(run=[str(cylinder_run)], frames=[2]))
    *_, last = open_shown(ViewOptions(run=[str(cylinder_run)]))
    assert torch.equal(alone.predictions[cylinder_run.name].labels, last.predictions[cylinder_run.name].labels)


def test_recorded_scenes_with_and_without_a_model(cylinder_run, dataset):
    alone = open_shown(ViewOptions(recorded=str(dataset), limit=4))
    assert alone.models == ()
    assert alone.grids[0].shape == (128, 200, 16)
    frames = list(alone)
    assert [frame.scene for frame in frames] == [SCENES[0]] * 3 + [SCENES[1]]
    assert all(frame.predictions == {} and (frame.truth[alone.grids[0]] > 0).sum() > 500 for frame in frames)
    with_model = open_shown(ViewOptions(run=[str(cylinder_run)], recorded=str(dataset), scene=SCENES[1]))
    own = open_shown(ViewOptions(run=[str(cylinder_run)]))
    for one, other in zip(with_model, own, strict=True):
        assert torch.equal(one.predictions[cylinder_run.name].labels, other.predictions[cylinder_run.name].labels)
        assert one.predictions[cylinder_run.name].figures == other.predictions[cylinder_run.name].figures


def test_frames_are_computed_again_when_iterated_again(cylinder_run):
    shown = open_shown(ViewOptions(run=[str(cylinder_run)], limit=2))
    first, second = list(shown), list(shown)
    assert all(
        torch.equal(one.predictions[cylinder_run.name].labels, other.predictions[cylinder_run.name].labels)
        for one, other in zip(first, second, strict=True)
    )


def test_the_first_frames_up_to_the_limit_are_chosen(capsys):
    lengths = {"a": 3, "b": 2, "c": 5}
    assert choose(lengths, None, None, None, "x") == {"a": (0, 1, 2), "b": (0, 1), "c": (0, 1, 2, 3, 4)}
    assert capsys.readouterr().out == ""
    assert choose(lengths, None, None, 4, "x") == {"a": (0, 1, 2), "b": (0,)}
    assert "the first 4 of 10 frames" in capsys.readouterr().out
    assert choose(lengths, "c", [4, 0, 4], 20, "x") == {"c": (0, 4)}
    for scene, frames, words in (
        ("d", None, "scene=d: there is no such scene in x; there are 3, such as a, b, c"),
        ("b", [2], r"frames=\[2\]: scene 'b' has the frames 0 to 1"),
        (None, [], "no frames are chosen"),
    ):
        with pytest.raises(UserError, match=words):
            choose(lengths, scene, frames, 20, "x")
    with pytest.raises(UserError, match="no test scenes"):
        choose({}, None, None, 20, "x")


def test_names_of_runs_are_short_and_unique():
    runs = ["runs/a-1", "runs/b-2/best.ckpt", "tiny", "elsewhere/a-1/last.ckpt", "best.ckpt"]
    assert unique_names(runs) == ["a-1", "b-2", "tiny", "a-1 (2)", "best.ckpt"]
    assert unique_names(["x/a (2)", "y/a", "z/a"]) == ["a (2)", "a", "a (3)"]


def test_pixels_outside_of_the_mask_are_unknown():
    labels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    mask = torch.ones(9, 13, dtype=torch.bool)  # more columns than three strides of four
    mask[7:, :5] = False
    found = mask_labels(labels, mask, 4)
    expected = labels.copy()
    expected[2, 0] = 255  # (row 8, column 2); column 6 is inside
    assert np.array_equal(found, expected)
    assert mask_labels(labels, None, 4) is labels


def test_impossible_choices_are_named_in_a_line(dataset, cylinder_run, tmp_path):
    empty = tmp_path / "empty-run"
    empty.mkdir()
    for options, words in (
        ({}, "nothing to show: give run="),
        ({"predictions": "x", "run": ["tiny"]}, "predictions="),
        ({"run": ["tiny"], "limit": 0}, "limit=0"),
        ({"run": [str(tmp_path / "nowhere")]}, "nowhere"),
        ({"run": [str(empty)]}, "neither best.ckpt nor last.ckpt"),
        ({"run": [str(cylinder_run)], "scene": "test-001-ther"}, "did you mean 'test-001-there'"),
        ({"recorded": str(tmp_path)}, "no recorded scenes"),
        ({"recorded": str(dataset), "frames": [7]}, "0 to 2"),
    ):
        with pytest.raises((UserError, FileNotFoundError)) as caught:
            open_shown(ViewOptions(**options))
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


def test_models_are_shown_with_the_threshold_of_their_weights(monkeypatch):
    monkeypatch.setattr(collect, "check_classes", lambda *_: None)
    monkeypatch.setattr(collect, "_scenes", lambda *_: None)
    monkeypatch.setattr(collect, "show_scenes", lambda scenes, models, grids: models)
    shown = open_shown(ViewOptions(run=("any-rig", "tiny")))
    assert [model.predictor.occupied_above for model in shown] == [0.2, None]
