"""Rows of the tables to which runs belong: by name, or else by configuration."""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from omniocc.config import compose_plain
from omniocc.io import read_yaml
from omniocc.progress import Progress
from omniocc.report.runs import FinishedRun
from omniocc.report.selection import given_values
from omniocc.runs.rows import FOLDER


def assign_rows(
    runs: Sequence[FinishedRun], conf: Path, rows: Sequence[str], known: Mapping[str, Sequence[str]]
) -> list[FinishedRun]:
    """Return the runs, each with its row.

    A run with the name of a row belongs to it. Any other run (`name=demo`) belongs to the first row whose
    configuration, composed with the run's preset and no other override, equals the run's, or else to its own row.

    Args:
        runs: finished runs.
        conf: folder of the configuration.
        rows: names of the tables' rows, whose order decides; those that are not in `known` are found only by name.
        known: overrides of rows, of `known_rows`.

    Raises:
        ConfigError: when a row cannot be composed.
    """
    named = {*rows, *known}
    tried = [row for row in dict.fromkeys([*rows, *sorted(known)]) if row in known]
    stated = {row: _stated(conf, known[row]) for row in tried}

    @functools.cache
    def composed(preset: str, row: str) -> dict:
        return given_values(compose_plain(conf, "train", [f"preset={preset}", *known[row]]))

    def with_row(run: FinishedRun) -> FinishedRun:
        preset = _preset(run)
        config = given_values(run.config)
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


def _stated(conf: Path, words: Sequence[str]) -> dict[str, Any]:
    """Return numbers and words that a row states itself, in its overrides or its file, by dotted key."""
    stated: dict[str, Any] = {}
    for key, _, value in (word.partition("=") for word in words):
        if key == f"+{FOLDER}":
            stated |= given_values(read_yaml(conf / FOLDER / f"{value}.yaml") or {})
        elif "/" not in key and not (conf / key).is_dir():
            stated |= given_values(OmegaConf.to_container(OmegaConf.from_dotlist([f"{key}={value}"])))  # type: ignore
    return {
        key: value
        for key, value in stated.items()
        if isinstance(value, bool | int | float | str) and "${" not in str(value)
    }
