"""The robustness test on recorded scenes of random patches and a model with random weights."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from made_scenes import RIG, write_checkpoint, write_scene

from omniocc.camera import Panoramic, Rig
from omniocc.config import build, plain
from omniocc.data import collate
from omniocc.data.dataset import WindowDataset
from omniocc.errors import UserError
from omniocc.extras.robustness import evaluation
from omniocc.extras.robustness.disturbance import disturb_scene
from omniocc.extras.robustness.evaluation import DIGITS, RobustnessTest, robustness_of, with_each_left_out
from omniocc.extras.robustness.parts import parts_of
from omniocc.parts import Parts
from omniocc.predict import load
from omniocc.runs.robustness import UNDISTURBED, drop_of
from omniocc.scores import Scores
from omniocc.train.build import build_task

FRAMES = 2
CPU = torch.device("cpu")
pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, smoke, spec) -> Path:
    """Return a checkpoint whose test scenes are two recorded ones."""
    folder = tmp_path_factory.mktemp("robust")
    for number in range(2):
        write_scene(folder / "data" / f"test-{number:03d}-nowhere", spec, 10 * number, FRAMES, RIG)
    splits = "data.source.splits={train:[],val:[],test:[test-*]}"
    cfg = smoke("data=recorded", f"data.source.root={folder / 'data'}", splits, "data.source.workers=0")
    return write_checkpoint(folder / "runs" / "some-12345678" / "best.ckpt", cfg, spec)


def run(checkpoint, folder, *wanted, scenes=8, seed=0):
    trained = load(checkpoint)
    return robustness_of(trained.task, trained.data, trained.checkpoint, wanted, scenes, seed, folder=folder)


@pytest.fixture(scope="module")
def tested(checkpoint, tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    return run(checkpoint, folder, "view_90_deg", "noise_10_percent", "extrinsics_3_deg"), folder


def test_every_part_has_scores_over_all_scenes_and_all_but_each(tested):
    record, folder = tested
    assert record.system == "some-12345678"
    names = [part.part for part in record.parts]
    assert names == [UNDISTURBED, "view_90_deg", "extrinsics_3_deg", "noise_10_percent"]
    assert sorted(path.stem for path in folder.glob("*.json")) == sorted(names)
    for part in record.parts:
        assert part.scenes == ["test-000-nowhere", "test-001-nowhere"]
        assert part.frames == 2 * FRAMES
        within = {f"rayiou_within_{range_m}m" for range_m in (8.5, 17, 25.6)}
        assert set(part.scores) == {"rayiou", "lidar/rayiou", "voxel/iou", "voxel/miou"} | within
        assert all(len(values) == 2 for values in part.without.values())
        assert part.scores["rayiou_within_8.5m"] != part.scores["rayiou"]
    view = record.parts[1]
    drop = drop_of(view, record.undisturbed)
    assert drop.value != 0
    assert math.isfinite(drop.error)


def test_scores_are_those_of_the_model_on_the_disturbed_frames(checkpoint, tested):
    """Everything is computed anew here, frame by frame, without the stream and without the module under test."""
    record, _ = tested
    trained = load(checkpoint)
    task, data = trained.task, trained.data
    data.prepare_data()
    part = next(part for part in parts_of(data.source.scenes("test")[0].rig.names, ()) if part.name == "view_90_deg")
    scenes = [disturb_scene(scene, part.disturbance, part.name, 0) for scene in data.source.scenes("test")]
    windows, scores = WindowDataset(scenes, data.voxels, data.window), Scores(task.model.geometry, data.source.spec)
    with torch.no_grad():
        for k in range(len(windows)):
            batch = collate([windows[k]])
            assert batch.candidates is None  # the sketch has to run on these images
            sketched = task.model.propose(batch.images[:, -1], batch.newest_rigs)
            assert sketched.candidates.any()
            scores.update(task.predict(batch).logits.argmax(1).to(torch.uint8), batch)
    expected = {key: float(value) for key, value in scores.compute().items()}
    for key in ("rayiou", "voxel/miou", "lidar/rayiou"):
        assert record.parts[1].scores[key] == pytest.approx(expected[key], abs=1e-6)


def test_the_same_seed_gives_the_same_figures_and_another_does_not(checkpoint, tested, tmp_path):
    record, _ = tested
    again = run(checkpoint, tmp_path / "again", "noise_10_percent")
    assert again.parts[-1].scores == record.parts[-1].scores
    assert again.parts[-1].without == record.parts[-1].without
    other = run(checkpoint, tmp_path / "other", "noise_10_percent", seed=1)
    assert other.parts[0].scores == record.parts[0].scores
    assert other.parts[-1].scores != record.parts[-1].scores


def test_finished_parts_are_kept_and_the_others_computed(checkpoint, tested, tmp_path, monkeypatch):
    record, folder = tested
    shutil.copytree(folder, tmp_path / "parts")
    (tmp_path / "parts" / "view_90_deg.json").unlink()  # as after a kill before it was finished
    computed = []
    score = RobustnessTest.score

    def counted(test, part, *rest):
        computed.append(part.name)
        return score(test, part, *rest)

    monkeypatch.setattr(RobustnessTest, "score", counted)
    again = run(checkpoint, tmp_path / "parts", "view_90_deg")
    assert computed == ["view_90_deg"]
    assert [part.part for part in again.parts] == [part.part for part in record.parts]  # those of the first call too
    assert [part.scores for part in again.parts] == [part.scores for part in record.parts]
    run(checkpoint, tmp_path / "parts", "view_90_deg", seed=5)
    assert computed == ["view_90_deg", UNDISTURBED, "view_90_deg"]  # of another seed


def test_a_damaged_part_is_named(checkpoint, tested, tmp_path):
    shutil.copytree(tested[1], tmp_path / "parts")
    (tmp_path / "parts" / f"{UNDISTURBED}.json").write_text("{")
    with pytest.raises(UserError, match=r"undisturbed\.json is damaged .*remove it"):
        run(checkpoint, tmp_path / "parts", "view_90_deg")


def test_recorded_scenes_cannot_be_rendered_anew(checkpoint, tmp_path, monkeypatch, capsys):
    with pytest.raises(UserError, match="weather, night: only scenes that the virtual world renders"):
        run(checkpoint, tmp_path, "weather_fog", "night", "view_90_deg")
    asked = []
    monkeypatch.setattr(RobustnessTest, "run", lambda test, parts, every, folder: asked.extend(parts) or [None])
    with pytest.raises(AttributeError):  # the stand-in returns no scores
        run(checkpoint, tmp_path, "all")
    assert not [part for part in asked if part.source]
    assert len(asked) == 38
    assert "left out: camera_late, weather, night: only scenes" in capsys.readouterr().out


@pytest.mark.parametrize(("scenes", "seed"), [(0, 0), (1, -1)])
def test_impossible_numbers_are_refused(checkpoint, tmp_path, scenes, seed):
    with pytest.raises(UserError, match="at least one scene"):
        run(checkpoint, tmp_path, "view", scenes=scenes, seed=seed)


def test_ranges_that_nothing_can_disturb_are_refused(make_task):
    evaluation.check_depth(make_task("model/sketch=dense"))
    evaluation.check_depth(make_task())
    with pytest.raises(UserError, match="model/depth=truth"):
        evaluation.check_depth(make_task("model/depth=truth"))


def test_scores_without_each_scene_are_those_of_the_others(make_task, spec):
    geometry = make_task("model/sketch=dense").model.geometry
    rng = np.random.default_rng(0)

    class Labelled:
        voxels = torch.from_numpy(rng.integers(0, 12, (1, *geometry.shape)).astype(np.uint8))
        scored = ray_origins = ray_times = lidar_labels = None

    def scores(*seeds):
        found = Scores(geometry, spec)
        for seed in seeds:
            labels = np.random.default_rng(seed).integers(0, 12, (1, *geometry.shape)).astype(np.uint8)
            found.update(torch.from_numpy(labels), Labelled)
        return found

    whole, without = with_each_left_out([scores(1), scores(2), scores(3)])
    assert whole["rayiou"] == round(float(scores(1, 2, 3).compute()["rayiou"]), DIGITS)
    expected = [float(scores(*rest).compute()["voxel/miou"]) for rest in ((2, 3), (1, 3), (1, 2))]
    assert without["voxel/miou"] == [round(value, DIGITS) for value in expected]
    assert "lidar/rayiou" not in whole
    assert with_each_left_out([scores(1)])[1]["rayiou"] == []
    without = with_each_left_out([scores(1), Scores(geometry, spec)])[1]  # the second scene has no labels
    assert math.isnan(without["rayiou"][0])
    assert without["rayiou"][1] == round(float(scores(1).compute()["rayiou"]), DIGITS)


def world_test(smoke, spec, trained, *overrides, scenes=8):
    """Return the test of a checkpoint on the virtual world, of which nothing is rendered."""
    cfg = smoke("model/sketch=dense", *overrides)
    task = build_task(Parts(cfg), spec)
    return RobustnessTest(task, build(cfg.data), {**plain(cfg)["data"]["source"], **trained}, scenes, 0, CPU)


def test_the_test_scenes_are_of_places_that_were_trained_on(smoke, spec):
    """The places that were left out come in a part of their own."""
    left_out = {"test_places": ["oldtown", "campus"]}
    test = world_test(smoke, spec, left_out, "data.source.test_places=[oldtown,campus]", "data.source.test_scenes=4")
    base = test.source({})
    assert {plan.split for plan in base.plans} == {"test"}
    assert len(base.plans) == 4
    assert not {"oldtown", "campus"} & {plan.theme for plan in base.plans}
    part = parts_of(("front",), test.unseen)[-1]
    assert {plan.theme for plan in test.source(part.source).plans} == {"oldtown", "campus"}
    assert test.renders


def test_an_override_makes_no_place_unseen(smoke, spec):
    test = world_test(smoke, spec, {"test_places": []}, "data.source.test_places=[oldtown]")
    assert test.unseen == ()
    assert "oldtown" in test.source({}).themes


def test_rendered_parts_are_other_data_with_the_same_scenes(smoke, spec):
    test = world_test(smoke, spec, {})
    base = test.source({})
    for part in parts_of(("front",), ()):
        if part.source:
            other = test.source(part.source)
            assert other.plans == base.plans
            assert other.name != base.name
            undisturbed = parts_of(("front",), ())[0]
            assert test.key(part, "w", other.fingerprint) != test.key(undisturbed, "w", base.fingerprint)


def test_another_threshold_gives_other_figures(smoke, spec):
    test, part = world_test(smoke, spec, {}), parts_of(("front",), ())[0]
    key = test.key(part, "w", "data")
    test.task.occupied_above = 0.2
    assert test.key(part, "w", "data") != key


def test_lenses_without_a_centre_have_no_wrong_focal_length(smoke, spec):
    test = world_test(smoke, spec, {})
    test.__dict__["rig"] = rig = Rig.load("fisheye6")  # replaces the rig of a rendered scene
    assert test.without_centre() == ""
    test.__dict__["rig"] = replace(rig, masks=None, cameras=(Panoramic(64, 32, 45.0, -45.0), *rig.cameras[1:]))
    assert test.without_centre() == "focal: images of Panoramic have no centre"


def test_facts_can_be_written_as_json(tested):
    record, _ = tested
    names = ["command", "commit", "machine", "checkpoint", "seed", "setting", "left out"]
    assert sorted(json.loads(json.dumps(record.facts))) == sorted(names)
