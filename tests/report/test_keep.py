"""Records of finished runs that are kept without checkpoints."""

import shutil

import pytest

from omniocc.errors import UserError
from omniocc.report.keep import keep_records
from omniocc.report.runs import read_runs
from omniocc.run.curves import read_curve
from omniocc.run.results import FROM_TRAJECTORY, OVERRIDES, save_results
from omniocc.run.robustness import UNDISTURBED, PartScores, Robustness, read_robustness, save_robustness
from omniocc.run.scenes import save_scenes


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


def test_a_test_of_weights_without_a_run_is_kept(tmp_path):
    test = Robustness(
        "tiny", {}, [PartScores(UNDISTURBED, UNDISTURBED, ["a"], 1, 1.0, {"rayiou": 0.5}, {"rayiou": []})]
    )
    save_robustness(tmp_path / "runs" / "robustness-tiny", test)
    assert keep_records(tmp_path / "runs", tmp_path / "kept") == [tmp_path / "kept" / "robustness-tiny"]
    assert read_robustness(tmp_path / "kept") == [test]


def test_without_a_finished_run_nothing_is_kept(tmp_path):
    with pytest.raises(UserError, match="holds no finished run"):
        keep_records(tmp_path, tmp_path / "kept")
