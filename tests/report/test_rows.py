"""Rows that cannot be composed, and runs of another name in the tables."""

import json
import shutil
from pathlib import Path

import pytest
import yaml

from omniocc.config import ConfigError, compose_plain, dotted
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import EVERY, _literal, _roots, assign_rows, read_sweeps
from omniocc.report.tables.paper import table_cells
from omniocc.runs.rows import known_rows, table_files

ROOT = Path(__file__).parents[2]
CONF = ROOT / "conf"


def test_a_row_that_cannot_be_composed_is_named(tmp_path):
    shutil.copytree(CONF, tmp_path / "conf")
    (tmp_path / "conf" / "ablation" / "broken.yaml").write_text(
        "# @package _global_\ndefaults: [override /model: gone]\n"
    )
    demo = FinishedRun("demo-0123abcd", {}, {}, config={"preset": {"name": "smoke"}})
    with pytest.raises(ConfigError, match=r"\+ablation=broken"):
        assign_rows([demo], tmp_path / "conf", ["broken"], {"broken": ["+ablation=broken"]})


def composed(words: list[str], resolve: bool) -> dict[str, object]:
    return dotted(compose_plain(CONF, "train", ["preset=tiny", *words], resolve))


def test_a_row_leaves_what_the_preset_states_below_other_roots():
    rows = known_rows(CONF, table_files(ROOT / "sweeps"))
    common = _literal(composed([], resolve=False))
    assert {"stages", "trainer", "depth", "data"} < {key.partition(".")[0] for key in common}
    for row in ("mono", "voxformer_pinhole", "voxformer_truth", "extended_disturbed", "bevdet_budget", "ours_01s"):
        values, roots = composed(rows[row], resolve=True), _roots(CONF, rows[row])
        changed = {key for key, value in common.items() if values.get(key) != value}
        assert {key.partition(".")[0] for key in changed} <= roots < {"stages", *roots}
    assert EVERY in _roots(CONF, ["model=of_a_package"]) & _roots(CONF, ["+group_of_a_package=option"])


def train(folder: Path, run: Path, name: str, facts: dict) -> None:
    """Make a run with the configuration of the row `ours` and the figures of another, under a name of its own."""
    shutil.copytree(run, folder / name)
    known = json.loads((folder / name / "metrics.json").read_text())
    (folder / name / "metrics.json").write_text(json.dumps(known | {"run": name} | facts))
    config = compose_plain(CONF, "train", [f"name={name[:-9]}", "preset=tiny"])
    (folder / name / "config.yaml").write_text(yaml.safe_dump(config))


EARLY, LATE = {"finished": "2026-01-01T00:00:00Z"}, {"finished": "2026-02-01T00:00:00Z"}
OTHER_RAYS = {"protocol": {"rayiou": "rays from eight origins", "voxel": "all cells"}}


@pytest.mark.parametrize(("rays", "commit"), [({}, "abc"), (OTHER_RAYS, "abc+")])
def test_a_newer_run_of_another_name_does_not_take_the_row(runs, tmp_path, rays, commit):
    train(tmp_path, runs / "ours-00000001", "ours-00000001", EARLY)
    train(tmp_path, runs / "dense-00000001", "mine-00000001", LATE | rays | {"commit": commit})
    sweep, *_ = read_sweeps(tmp_path, ROOT / "sweeps", CONF, None)
    assert {row: [run.name for run in members] for row, members in sweep.rows.items()} == {"ours": ["ours-00000001"]}
    reason = (
        "since their scores are counted by another protocol: mine-00000001 (voxel RayIoU: rays from eight origins)."
    )
    assert (
        f"Left out, {reason if rays else 'runs of other names of the same row and seed: mine-00000001'}" in sweep.remark
    )


def test_many_runs_counted_otherwise_do_not_displace_the_run_of_the_row(runs, tmp_path):
    train(tmp_path, runs / "ours-00000001", "ours-00000001", EARLY)
    for number in range(1, 4):
        name = f"mine-0000000{number}"
        train(tmp_path, runs / "dense-00000001", name, LATE | OTHER_RAYS | {"seed": number, "commit": "abc+"})
    sweep, *_ = read_sweeps(tmp_path, ROOT / "sweeps", CONF, None)
    assert [run.name for run in sweep.runs] == ["ours-00000001"]


def test_a_run_of_a_commit_comes_before_a_newer_one_of_changed_code(runs, tmp_path):
    train(tmp_path, runs / "ours-00000001", "ours-00000001", EARLY)
    train(tmp_path, runs / "ours-00000001", "ours-0000000a", LATE | {"commit": "abc+"})
    train(tmp_path, runs / "ours-00000001", "ours-0000000b", LATE | {"commit": "unknown"})
    sweep, *_ = read_sweeps(tmp_path, ROOT / "sweeps", CONF, None)
    assert [run.name for run in sweep.runs] == ["ours-00000001"]
    assert "changed code of the same row and seed: ours-0000000a, ours-0000000b" in sweep.remark


def test_runs_of_more_steps_counted_otherwise_are_not_beside_the_others(runs, tmp_path):
    train(tmp_path, runs / "ours-00000001", "ours-00000001", {})
    train(tmp_path, runs / "ours-00000002", "ours-00000002", {})
    train(tmp_path, runs / "ours-00000001", "ours-00000003", {"steps": 400} | OTHER_RAYS)
    train(tmp_path, runs / "ours-00000001", "ours-00000004", {"steps": 4000})
    first, *_ = read_sweeps(tmp_path, ROOT / "sweeps", CONF, None)
    assert list(first.lengths) == ["ours@40", "ours@4000"]
    assert [sweep.runs[0].name for sweep in first.longer] == ["ours-00000004"]
    assert "ours-00000003 (voxel RayIoU: rays from eight origins)" in first.remark


def test_a_run_of_another_name_counts_in_the_row_whose_configuration_it_has(runs, tmp_path):
    shutil.copytree(runs / "dense-00000001", tmp_path / "demo-0123abcd")
    facts = json.loads((tmp_path / "demo-0123abcd" / "metrics.json").read_text())
    (tmp_path / "demo-0123abcd" / "metrics.json").write_text(json.dumps(facts | {"run": "demo-0123abcd"}))
    config = compose_plain(CONF, "train", ["name=demo", "preset=tiny"])
    (tmp_path / "demo-0123abcd" / "config.yaml").write_text(yaml.safe_dump(config))
    sweep, *_ = read_sweeps(tmp_path, ROOT / "sweeps", CONF, None)
    assert list(sweep.rows) == ["ours"]
    assert "ours" not in sweep.not_run
    assert "demo-0123abcd (ours)" in sweep.remark
    (table,) = (table for table in sweep.tables if table.number == 2)
    head, lines = table_cells(table, sweep.rows)
    assert {line[0]: dict(zip(head, line, strict=True)) for line in lines}["Seeds"]["OmniDepth-Occ, here"] == "1"
