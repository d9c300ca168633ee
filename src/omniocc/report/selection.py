"""Selection of the runs of a report: those of one setting, one for each row and seed."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

from omniocc.config import dotted
from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.run.folder import METRICS, VOLATILE
from omniocc.run.results import FINISHED, utc_text

ABSENT = object()
Place = tuple[tuple[str, Any], tuple[str, ...]]
"""Row and seed, and setting, of a run."""
OF_MACHINES = ("root", "cache", "workers", "num_workers", "accelerator", "seed")
"""Keys at any depth that may differ between runs of one row."""


def settings_of(runs: Sequence[FinishedRun], preset: str | None) -> list[tuple[str, ...]]:
    """Return preset, steps and data of the runs, the setting that most of them have first.

    Args:
        runs: at least one.
        preset: of the runs that count; None: any.

    Raises:
        UserError: when no run has that preset.
    """
    candidates = [run for run in runs if preset in (None, run.facts.get("preset"))]
    if not candidates:
        found = sorted({str(run.facts.get("preset", "unknown")) for run in runs})
        raise UserError(f"no finished run of preset {preset}; there are runs of {', '.join(found)}")
    return [setting for setting, _ in Counter(run.setting for run in candidates).most_common()]


def comparable(runs: Sequence[FinishedRun], setting: tuple[str, ...]) -> tuple[list[FinishedRun], str]:
    """Return the runs of one preset, number of steps and dataset, and a remark on them and on what is left out.

    Of several runs of a row with one seed the newest is taken.
    """
    chosen, same = setting, [run for run in runs if run.setting == setting]
    newest = newest_of(same)
    kept = [run for run in same if newest[run.place, setting] is run]
    commits = sorted({str(run.facts.get("commit", "unknown")) for run in kept})
    name, steps, data = chosen
    text = f"preset={name}, {steps} steps, data {data[:8]}, commit {', '.join(commits)}."
    if others := sorted(run.name for run in runs if run.setting != chosen):
        text += f" Of another preset, number of steps or dataset: {', '.join(others)}."
    if alike := sorted(f"{run.name} ({run.same_as})" for run in kept if run.same_as):
        text += f" Counted in the row whose configuration they have: {', '.join(alike)}."
    if older := sorted(_replaced(same, newest)):
        text += f" Left out, older runs of the same row and seed: {', '.join(older)}."
    return kept, text


def newest_of(runs: Sequence[FinishedRun]) -> dict[Place, FinishedRun]:
    """Return the newest run of each row, seed and setting: the last that finished."""
    return {(run.place, run.setting): run for run in sorted(runs, key=_finished)}


def _finished(run: FinishedRun) -> tuple[str, str]:
    """Return when a run finished, and its name; runs that did not record it have the time of their file."""
    path = run.folder / METRICS
    written = path.stat().st_mtime if path.exists() else 0.0
    return run.facts.get(FINISHED) or utc_text(written), run.name


def _replaced(runs: Sequence[FinishedRun], newest: Mapping[Place, FinishedRun]) -> Iterator[str]:
    """Yield the names of runs that are not the newest of their place, and the keys in which they differ from it."""
    for run in runs:
        if (newer := newest[run.place, run.setting]) is not run:
            keys = differences([run, newer])
            yield run.name + (f" (of another {keys} than {newer.name})" if keys else "")


def mixtures(rows: Mapping[str, Sequence[FinishedRun]]) -> Iterator[str]:
    """Yield a warning for each row whose seeds were trained with different configurations."""
    for row, runs in rows.items():
        if keys := differences(runs):
            yield f"Warning: the runs of row {row} differ in {keys}; another name=... makes a row of its own."


def differences(runs: Sequence[FinishedRun]) -> str:
    """Return the keys, four at most, whose values differ between runs.

    Keys of only one of two commits are new options, not differences.
    """
    found: set[str] = set()
    versions = [(run.facts.get("commit"), compared(run.config)) for run in runs]
    for (commit, left), (other_commit, right) in combinations(versions, 2):
        keys = left.keys() | right.keys() if commit == other_commit else left.keys() & right.keys()
        found |= {key for key in keys if left.get(key, ABSENT) != right.get(key, ABSENT)}
    keys = sorted(found)
    return f"{', '.join(keys[:4])}{' and more' * (len(keys) > 4)}"


def compared(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configuration without name, seed, machine and `VOLATILE`, by dotted key; equal for runs of one row."""
    values = dotted({key: value for key, value in config.items() if key not in ("name", *VOLATILE)})
    return {key: value for key, value in values.items() if not set(key.split(".")) & set(OF_MACHINES)}


def given(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return `compared` without keys that are null.

    A key that a later commit added and that is null then tells no runs apart.
    """
    return {key: value for key, value in compared(config).items() if value is not None}


def by_row(runs: Sequence[FinishedRun]) -> dict[str, list[FinishedRun]]:
    """Return the runs of each row of the tables, by seed.

    Raises:
        UserError: when a row has two runs with the same seed, which then differ in something else.
    """
    rows: dict[str, list[FinishedRun]] = {}
    for run in sorted(runs, key=lambda run: run.facts.get("seed") or 0):
        rows.setdefault(run.row, []).append(run)
    for row, members in rows.items():
        seed, times = Counter(run.facts.get("seed") for run in members).most_common(1)[0]
        if times > 1:
            names = ", ".join(run.name for run in members if run.facts.get("seed") == seed)
            raise UserError(f"row {row} has {times} runs with seed {seed} ({names}); move all but one elsewhere")
    return rows
