"""Which runs are compared, and what their configurations say."""

import json
import os
import shutil

import pytest
import yaml

from omniocc.report.runs import known_figures, read_runs
from omniocc.report.selection import by_row, comparable, mixtures, settings_of
from omniocc.runs.results import CANDIDATES


def comparable_of(folder):
    found = read_runs(folder)
    return comparable(found, settings_of(found, None)[0])


def test_figures_that_need_no_test():
    config = {"model": {"geometry": {"shape": [64, 100, 8]}}}
    assert known_figures({CANDIDATES: 0.25}, config) == {"voxels": 51_200.0, "test/sketch/fraction": 0.25}
    assert known_figures({CANDIDATES: 1.0}, {}) == {"test/sketch/fraction": 1.0, "test/sketch/recall": 1.0}
    assert known_figures({}, {}) == {}


def test_measured_figures_win_over_configured_ones(runs):
    by_name = {run.name: run for run in read_runs(runs)}
    assert by_name["ours-00000001"].metrics["test/sketch/fraction"] == 0.25
    assert by_name["dense-00000001"].metrics["test/sketch/fraction"] == 1.0
    assert by_name["cuboid-00000001"].metrics["voxels"] == 256.0


def test_runs_whose_score_is_no_number_come_last(runs, tmp_path):
    folder = tmp_path / "runs"
    shutil.copytree(runs, folder)
    best = read_runs(folder)[0].name
    path = folder / best / "metrics.json"
    content = json.loads(path.read_text())
    content["metrics"]["test/rayiou"] = None
    path.write_text(json.dumps(content))
    found = read_runs(folder)
    scores = [run.metrics["test/rayiou"] for run in found]
    assert found[-1].name == best
    assert scores[:-1] == sorted(scores[:-1], reverse=True)


def test_of_two_runs_with_one_seed_the_newest_counts(runs, tmp_path):
    folder = tmp_path / "runs"
    shutil.copytree(runs, folder)
    shutil.copytree(runs / "ours-00000001", folder / "ours-0000000a")
    os.utime(folder / "ours-0000000a" / "metrics.json", (1, 1))
    kept, remark = comparable_of(folder)
    assert [run.name for run in by_row(kept)["ours"]] == ["ours-00000001", "ours-00000002"]
    assert "older runs of the same row and seed: ours-0000000a" in remark
    os.utime(folder / "ours-0000000a" / "metrics.json", (2e10, 2e10))
    kept, _ = comparable_of(folder)
    assert "ours-0000000a" in [run.name for run in by_row(kept)["ours"]]


def test_seeds_of_one_row_with_other_settings_are_named(runs, tmp_path):
    folder = tmp_path / "runs"
    shutil.copytree(runs, folder)
    assert not list(mixtures(by_row(read_runs(folder))))
    path = folder / "ours-00000002" / "config.yaml"
    config = yaml.safe_load(path.read_text())
    config["data"]["source"]["root"], config["lr"], config["new key"] = "elsewhere", 0.2, 1
    path.write_text(yaml.safe_dump(config))
    (warning,) = mixtures(by_row(read_runs(folder)))
    assert "ours differ in lr, new key; another name=..." in warning
    facts = yaml.safe_load((path.parent / "metrics.json").read_text())
    (path.parent / "metrics.json").write_text(json.dumps(facts | {"commit": "0123abc"}))
    (warning,) = mixtures(by_row(read_runs(folder)))
    assert "of row ours differ in lr;" in warning  # of another version, which had a new option


def test_a_damaged_file_is_named_and_its_run_left_out(runs, tmp_path, capsys):
    folder = tmp_path / "runs"
    shutil.copytree(runs, folder)
    metrics, listed, config = (folder / f"{name}-00000001" for name in ("ours", "dense", "cuboid"))
    (metrics / "metrics.json").write_text((metrics / "metrics.json").read_text()[:60])
    (listed / "metrics.json").write_text("[1, 2]")
    (config / "config.yaml").write_text("model: {geometry: [")
    left = {run.name for run in read_runs(folder)}
    assert left == {run.name for run in read_runs(runs)} - {metrics.name, listed.name, config.name}
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("reading runs")]
    assert [line.split(" is damaged")[0] for line in lines] == [
        f"left out: {path}" for path in (config / "config.yaml", listed / "metrics.json", metrics / "metrics.json")
    ]


@pytest.mark.parametrize("geometry", ["grid", "{shape: [a, b]}", f"{{shape: [{10**300}, 2]}}", "{_target_: 7}"])
def test_a_run_without_a_grid_is_left_out(geometry, runs, tmp_path, capsys):
    folder = tmp_path / "runs"
    for name in ("ours-00000001", "dense-00000001"):
        shutil.copytree(runs / name, folder / name)
    (folder / "dense-00000001" / "config.yaml").write_text(f"model: {{geometry: {geometry}}}")
    assert [run.name for run in read_runs(folder)] == ["ours-00000001"]
    assert "dense-00000001/config.yaml is damaged: model.geometry" in capsys.readouterr().err


def test_what_tells_a_replaced_run_from_the_newer_one_is_said(runs, tmp_path):
    folder = tmp_path / "runs"
    shutil.copytree(runs, folder)
    other = folder / "ours-0000000a"
    shutil.copytree(runs / "ours-00000001", other)
    config = yaml.safe_load((other / "config.yaml").read_text())
    (other / "config.yaml").write_text(yaml.safe_dump(config | {"loss": {"weights": {"ranges": 1.0}}}))
    os.utime(other / "metrics.json", (1, 1))
    assert "ours-0000000a (of another loss.weights.ranges than ours-00000001)" in comparable_of(folder)[1]


def test_a_folder_whose_name_cannot_be_written_is_left_out(runs, tmp_path, capsys):
    for name in ("ours-00000001", os.fsdecode(b"m\xff-00000001")):
        shutil.copytree(runs / "ours-00000001", tmp_path / name)
    assert [run.name for run in read_runs(tmp_path)] == ["ours-00000001"]
    assert r"a run's folder is named 'm\udcff-00000001', which cannot be written" in capsys.readouterr().err
