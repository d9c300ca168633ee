"""Records of finished runs that are kept without checkpoints."""

import json
import os
import shutil

import pytest

from omniocc.errors import UserError
from omniocc.report.keep import keep_records
from omniocc.report.runs import read_runs
from omniocc.runs.curves import read_curve
from omniocc.runs.results import FINISHED, FROM_TRAJECTORY, OVERRIDES, save_results, utc_text
from omniocc.runs.robustness import UNDISTURBED, PartScores, Robustness, read_robustness, save_robustness
from omniocc.runs.scenes import save_scenes


def test_every_figure_and_curve_can_be_read_from_what_is_kept(runs, tmp_path):
    kept = tmp_path / "kept"
    runs = shutil.copytree(runs, tmp_path / "runs")
    counts = {"a": {"rays": [[0, 2], [0, 2], [0, 1]]}}
    save_scenes(runs / "ours-00000001", counts, {"a": {"weather": "rain"}}, ("Free", "Road"), (1.0,))
    data = read_runs(runs)[0].facts["data"]
    tested = {"test/rayiou": 0.2, "test/rayiou_past": 0.1, "test/voxel/iou": 0.5}
    save_results(runs / "dense-00000001" / FROM_TRAJECTORY, tested, {"data": data, OVERRIDES: []})
    assert [path.name for path in keep_records(runs, kept)] == [run.name for run in read_runs(runs)]
    for run, copy in zip(read_runs(runs), read_runs(kept), strict=True):
        assert (run.facts, run.metrics, run.config) == (copy.facts, copy.metrics, copy.config)
        assert ("test/weather/rain/rayiou" in copy.metrics) == (run.name == "ours-00000001")
        assert ("test/trajectory/rayiou_past" in copy.metrics) == (run.name == "dense-00000001")
        assert read_curve(copy.folder, "train/loss") == read_curve(run.folder, "train/loss") != {}
    assert not [path for path in kept.rglob("*") if path.suffix == ".png"]


def test_a_newer_run_replaces_that_of_its_row_and_seed_alone(runs, tmp_path):
    kept, later = tmp_path / "kept", tmp_path / "later"
    keep_records(runs, kept)
    shutil.copytree(runs / "ours-00000001", later / "ours-0000000a")
    keep_records(later, kept)
    names = {run.name for run in read_runs(kept)}
    assert names == {run.name for run in read_runs(runs)} - {"ours-00000001"} | {"ours-0000000a"}


def test_a_newer_run_of_changed_code_does_not_replace_that_of_a_commit(runs, tmp_path):
    kept, later = tmp_path / "kept", tmp_path / "later"
    keep_records(runs, kept)
    path = shutil.copytree(runs / "ours-00000001", later / "ours-0000000a") / "metrics.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {FINISHED: utc_text(4e9), "commit": "abc+"}))
    assert keep_records(later, kept) == []
    assert {run.name for run in read_runs(kept)} == {run.name for run in read_runs(runs)}


def test_of_two_runs_of_a_row_and_seed_the_newest_is_kept(runs, tmp_path):
    """The one that finished last, whatever the time of its file."""
    shutil.copytree(runs, tmp_path / "runs")
    newer = shutil.copytree(runs / "ours-00000001", tmp_path / "runs" / "ours-0000000a") / "metrics.json"
    newer.write_text(json.dumps(json.loads(newer.read_text()) | {FINISHED: utc_text(4e9)}))
    os.utime(newer, (1, 1))
    kept = keep_records(tmp_path / "runs", tmp_path / "kept")
    assert "ours-0000000a" in {path.name for path in kept}
    assert "ours-00000001" not in {path.name for path in (tmp_path / "kept").iterdir()}
    assert utc_text(4e9) == "2096-10-02T07:06:40Z"


def test_a_run_that_was_trained_again_loses_the_later_tests_of_its_former_weights(runs, tmp_path):
    kept, again = tmp_path / "kept", shutil.copytree(runs, tmp_path / "again")
    data = read_runs(runs)[0].facts["data"]
    for name in ("ours-00000001", "dense-00000001"):
        save_results(again / name / FROM_TRAJECTORY, {"test/rayiou_past": 0.1}, {"data": data, OVERRIDES: []})
    keep_records(again, kept)
    for name in ("ours-00000001", "dense-00000001"):
        shutil.rmtree(again / name / FROM_TRAJECTORY)
    metrics = again / "ours-00000001" / "metrics.json"
    metrics.write_text(json.dumps(json.loads(metrics.read_text()) | {FINISHED: utc_text(4e9)}))
    keep_records(again, kept)
    assert not (kept / "ours-00000001" / FROM_TRAJECTORY).exists()
    assert (kept / "dense-00000001" / FROM_TRAJECTORY / "metrics.json").exists()
    assert {run.name for run in read_runs(kept)} == {run.name for run in read_runs(runs)}


def test_a_test_of_weights_without_a_run_is_kept(tmp_path):
    test = Robustness(
        "tiny", {}, [PartScores(UNDISTURBED, UNDISTURBED, ["a"], 1, 1.0, {"rayiou": 0.5}, without={"rayiou": []})]
    )
    save_robustness(tmp_path / "runs" / "robustness-tiny", test)
    assert keep_records(tmp_path / "runs", tmp_path / "kept") == [tmp_path / "kept" / "robustness-tiny"]
    assert read_robustness(tmp_path / "kept") == [test]


def test_without_a_finished_run_nothing_is_kept(tmp_path):
    with pytest.raises(UserError, match="holds no finished run"):
        keep_records(tmp_path, tmp_path / "kept")
