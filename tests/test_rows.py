"""Every row of the tables: its configuration passes the check, and finds the runs that have it."""

import copy
import functools
from pathlib import Path
from typing import Any

import pytest
import yaml

from omniocc.config import check_root, compose_plain, plain
from omniocc.io import YAML
from omniocc.report import rows
from omniocc.report.rows import assign_rows
from omniocc.report.runs import FinishedRun

CONF = Path(__file__).parents[1] / "conf"
FOLDER = CONF / "ablation"
OPTIONS = {
    path.relative_to(FOLDER).with_suffix("").as_posix(): yaml.safe_load(path.read_text())["name"]
    for path in sorted(FOLDER.rglob("*.yaml"))
}
"""Name of every row, by its option."""
OWN = [option for option in OPTIONS if not option.startswith("learning_rates")]
"""Options of the rows with a configuration of their own; one of the tried rates is that of its system."""
MINE = {"name": "mine", "seed": 3, "paths.data": "elsewhere", "data.num_workers": 0, "test_images": 0}
MINE |= {"logger.mode": "disabled"}
"""Keys and values of a run of one's own that do not change what it computes."""


def overrides_of(option: str) -> tuple[str, str]:
    """Return the words with which both tests compose a row, so that a process composes it once."""
    return "preset=tiny", f"+ablation={option}"


@pytest.mark.parametrize("option", OPTIONS)
def test_a_row_passes_the_check_and_is_called_as_its_file(option, composed):
    cfg = composed(*overrides_of(option))
    check_root(cfg)
    folder, _, stem = option.rpartition("/")
    assert cfg.seed == 0, "a row leaves the seed to the command"
    assert cfg.name == OPTIONS[option] == (f"tried_{stem}" if folder == "tried" else stem)
    if folder:
        assert f"+ablation={option}\n" in (FOLDER / f"{option}.yaml").read_text()


def test_runs_are_told_by_their_configuration_unless_their_name_is_that_of_a_row(monkeypatch, composed):
    """A run of a row has the values that the row is composed of, but for those of `MINE`."""
    tree = functools.cache(lambda *overrides: plain(composed(*overrides)))
    monkeypatch.setattr(rows, "compose_plain", lambda conf, name, overrides: tree(*overrides))
    runs = [finished("mine", with_values(tree(*overrides_of(option)), MINE)) for option in OWN]
    others = [
        run_of("mine", "+ablation=wo_dilation", *(f"{key}={value}" for key, value in MINE.items())),
        run_of("deep", "preset.lifter.coloring.layers=2"),
        run_of("mono"),
        run_of("of_a_table"),
        run_of("demo"),
        FinishedRun("nothing saved-0123abcd", {}, {}),
        run_of("lost", "preset.name=gone"),
    ]
    found = [run.row for run in assign_rows([*runs, *others], CONF, ["ours", "of_a_table"])]
    names = [OPTIONS[option] for option in OWN]
    assert found == [*names, "wo_dilation", "deep", "mono", "of_a_table", "ours", "nothing saved", "lost"]


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
