"""Every row of the tables: its configuration passes the check, and finds the runs that have it."""

import copy
import functools
from pathlib import Path
from typing import Any

import pytest
import yaml

from omniocc.config import check_root, compose_plain, plain
from omniocc.io import YAML
from omniocc.report import sweep
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import assign_rows
from omniocc.runs.rows import TABLES, known_rows, table_files

CONF = Path(__file__).parents[1] / "conf"
ROWS = known_rows(CONF, table_files(CONF / TABLES))
MINE = {"name": "mine", "seed": 3, "paths.data": "elsewhere", "data.num_workers": 0, "test_images": 0}
MINE |= {"logger.mode": "disabled"}
"""Keys and values of a run of one's own that do not change what it computes."""


@pytest.mark.parametrize("row", ROWS)
def test_a_row_passes_the_check_and_has_its_name(row, composed):
    cfg = composed("preset=tiny", *ROWS[row])
    check_root(cfg)
    assert cfg.seed == 0, "a row leaves the seed to the command"
    assert cfg.name == row


def test_runs_are_told_by_their_configuration_unless_their_name_is_that_of_a_row(monkeypatch, composed):
    """A run of a row has the values that the row is composed of, but for those of `MINE`."""
    tree = functools.cache(lambda *overrides: plain(composed(*overrides)))
    monkeypatch.setattr(
        sweep,
        "compose_plain",
        lambda conf, name, words, resolve=True: tree(*words) if resolve else compose_plain(conf, name, words, resolve),
    )
    runs = [finished("mine", with_values(tree("preset=tiny", *words), MINE)) for words in ROWS.values()]
    others = [
        run_of("mine", "+ablation=wo_dilation", *(f"{key}={value}" for key, value in MINE.items())),
        run_of("deep", "model.lifter.layers=2"),
        run_of("mono"),
        run_of("of_a_table"),
        run_of("demo"),
        FinishedRun("nothing saved-0123abcd", {}, {}),
        run_of("lost", "preset.name=gone"),
    ]
    found = [run.row for run in assign_rows([*runs, *others], CONF, ["ours", "of_a_table"], ROWS)]
    own = ["wo_semantic_head" if row == "twenty_lidars" else row for row in ROWS]  # one configuration, two rows
    assert found == [*own, "wo_dilation", "deep", "mono", "of_a_table", "ours", "nothing saved", "lost"]


def run_of(name: str, *overrides: str) -> FinishedRun:
    return finished(name, compose_plain(CONF, "train", ["preset=tiny", *overrides]))


def finished(name: str, config: dict) -> FinishedRun:
    """Return a run with this configuration as it is after it was written to a file and read."""
    written = yaml.dump(config, Dumper=yaml.CSafeDumper)
    return FinishedRun(f"{name}-0123abcd", {"seed": 3}, {}, config=yaml.load(written, YAML))


def with_values(config: dict, values: dict[str, Any]) -> dict:
    """Return a copy of a configuration with other values, given by dotted key."""
    config = copy.deepcopy(config)
    for key, value in values.items():
        *parents, last = key.split(".")
        functools.reduce(dict.__getitem__, parents, config)[last] = value
    return config
