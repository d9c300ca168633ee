"""Rows that cannot be composed, and runs of another name in the tables."""

import json
import shutil
from pathlib import Path

import pytest
import yaml

from omniocc.config import ConfigError, compose_plain
from omniocc.report.rows import assign_rows
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import read_sweeps
from omniocc.report.tables.paper import as_markdown

ROOT = Path(__file__).parents[2]
CONF = ROOT / "conf"


def test_a_row_that_cannot_be_composed_is_named(tmp_path):
    shutil.copytree(CONF, tmp_path / "conf")
    (tmp_path / "conf" / "ablation" / "broken.yaml").write_text(
        "# @package _global_\ndefaults: [override /model: gone]\n"
    )
    demo = FinishedRun("demo-0123abcd", {}, {}, config={"preset": {"name": "smoke"}})
    with pytest.raises(ConfigError, match=r"\+ablation=broken"):
        assign_rows([demo], tmp_path / "conf", ["broken"])


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
