"""Runs find their row by name, or by configuration."""

import functools
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml
from omegaconf import OmegaConf

from omniocc.config import ConfigError, compose_plain, plain
from omniocc.io import YAML
from omniocc.report import rows
from omniocc.report.rows import assign_rows
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import read_sweeps
from omniocc.report.tables.paper import as_markdown

ROOT = Path(__file__).parents[2]
CONF = ROOT / "conf"
OPTIONS = {
    yaml.safe_load(path.read_text())["name"]: path.relative_to(CONF / "ablation").with_suffix("")
    for path in (CONF / "ablation").rglob("*.yaml")
}
ROWS = sorted(row for row, path in OPTIONS.items() if path.parts[0] != "learning_rates")  # one has that of its system


MINE = ("name=mine", "seed=3", "paths.data=elsewhere", "data.num_workers=0", "test_images=0", "logger.mode=disabled")


def run_of(name: str, *overrides: str) -> FinishedRun:
    return finished(name, compose_plain(CONF, "train", ["preset=smoke", *overrides]))


def finished(name: str, config: dict) -> FinishedRun:
    """Return a run with this configuration as it is after it was written to a file and read."""
    written = yaml.dump(config, Dumper=yaml.CSafeDumper)
    return FinishedRun(f"{name}-0123abcd", {"seed": 3}, {}, config=yaml.load(written, YAML))


def test_runs_are_told_by_their_configuration_unless_their_name_is_that_of_a_row(monkeypatch):
    """Every row is composed once: a run of it has the same values, but for those of `MINE`."""
    composed = functools.cache(lambda *overrides: compose_plain(CONF, "train", overrides))
    monkeypatch.setattr(rows, "compose_plain", lambda conf, name, overrides: composed(*overrides))
    runs = [
        finished("mine", with_values(composed("preset=smoke", f"+ablation={OPTIONS[row].as_posix()}"), MINE))
        for row in ROWS
    ]
    others = [
        run_of("mine", "+ablation=wo_dilation", *MINE),
        run_of("deep", "preset.lifter.coloring.layers=2"),
        run_of("mono"),
        run_of("of_a_table"),
        run_of("demo"),
        FinishedRun("nothing saved-0123abcd", {}, {}),
        run_of("lost", "preset.name=gone"),
    ]
    found = [run.row for run in assign_rows([*runs, *others], CONF, ["ours", "of_a_table"])]
    assert found == [*ROWS, "wo_dilation", "deep", "mono", "of_a_table", "ours", "nothing saved", "lost"]


def with_values(config: dict, overrides: Sequence[str]) -> dict:
    tree = OmegaConf.create(config)
    tree.merge_with_dotlist(list(overrides))
    return plain(tree)


def test_a_row_that_cannot_be_composed_is_named(tmp_path):
    shutil.copytree(CONF, tmp_path / "conf")
    (tmp_path / "conf" / "ablation" / "broken.yaml").write_text(
        "# @package _global_\ndefaults: [override /model: gone]\n"
    )
    with pytest.raises(ConfigError, match=r"\+ablation=broken"):
        assign_rows([run_of("demo")], tmp_path / "conf", ["broken"])


def test_a_run_of_another_name_counts_in_the_row_whose_configuration_it_has(runs, tmp_path):
    shutil.copytree(runs / "dense-00000001", tmp_path / "demo-0123abcd")
    facts = json.loads((tmp_path / "demo-0123abcd" / "metrics.json").read_text())
    (tmp_path / "demo-0123abcd" / "metrics.json").write_text(json.dumps(facts | {"run": "demo-0123abcd"}))
    config = compose_plain(CONF, "train", ["name=demo", "preset=tiny", "+learning_rate=chain"])
    (tmp_path / "demo-0123abcd" / "config.yaml").write_text(yaml.safe_dump(config))
    sweep, *_ = read_sweeps(tmp_path, ROOT / "sweeps", CONF, None)
    assert list(sweep.rows) == ["ours"]
    assert "ours" not in sweep.not_run
    assert "Counted in the row whose configuration they have: demo-0123abcd (ours)." in sweep.remark
    (table,) = (table for table in sweep.tables if table.number == 2)
    lines = [line for line in as_markdown(table, sweep.rows).splitlines() if "OmniDepth-Occ" in line]
    assert lines
    assert not any("not run" in line for line in lines)
