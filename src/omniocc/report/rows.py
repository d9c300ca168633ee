"""Rows of the tables to which runs belong: by name, or else by configuration."""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from omniocc.config import compose_plain
from omniocc.io import read_yaml
from omniocc.progress import Progress
from omniocc.report.runs import FinishedRun
from omniocc.report.selection import given
from omniocc.run.rows import FOLDER, options_of


def assign_rows(
    runs: Sequence[FinishedRun],
    conf: Path,
    rows: Sequence[str],
    own: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> list[FinishedRun]:
    """Return the runs, each with its row.

    A run with the name of a row belongs to it. Any other run (`name=demo`) belongs to the first row whose
    configuration, composed with the run's preset and no other override, equals the run's, or else to its own row.

    Args:
        runs: finished runs.
        conf: folder of the configuration, with the rows in `ablation/`, those beyond the paper in its subfolders. A
            row is called as its runs are, by its key `name`.
        rows: names of the tables' rows; rows without a file in `conf` and overrides are found only by name.
        own: overrides of rows that a table trains itself.

    Raises:
        ConfigError: when a row cannot be composed.
    """
    options = options_of(conf)
    overrides = {row: [f"+{FOLDER}={option}"] for row, option in options.items()} | dict(own)
    named = {*rows, *overrides}
    tried = [row for row in dict.fromkeys([*rows, *sorted(named)]) if row in overrides]
    files = {row: read_yaml(conf / FOLDER / f"{options[row]}.yaml") or {} for row in tried if row not in own}
    stated = {row: _stated(files.get(row, {})) for row in tried}

    @functools.cache
    def composed(preset: str, row: str) -> dict:
        return given(compose_plain(conf, "train", [f"preset={preset}", *overrides[row]]))

    def with_row(run: FinishedRun) -> FinishedRun:
        preset = _preset(run)
        config = given(run.config)
        # composing a row takes .2 s, so those that state another value are left out first
        likely = (row for row in tried if all(config.get(key, value) == value for key, value in stated[row].items()))
        return run._replace(same_as=next((row for row in likely if composed(preset, row) == config), None))

    found = list(runs)
    presets = {path.stem for path in (conf / "preset").glob("*.yaml")}
    unnamed = [index for index, run in enumerate(runs) if run.row not in named and _preset(run) in presets]
    if not unnamed:
        return found
    with Progress("comparing runs of other names with the rows", len(unnamed), unit="runs") as progress:
        for index in unnamed:
            found[index] = with_row(runs[index])
            progress.advance()
    return found


def _preset(run: FinishedRun) -> str:
    return str(run.config.get("preset", {}).get("name"))


def _stated(file: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers and words that the file of a row states itself, by dotted key."""
    plain = {key: value for key, value in given(file).items() if isinstance(value, bool | int | float | str)}
    return {key: value for key, value in plain.items() if "${" not in str(value)}
