"""Selection of the runs of a report: those of one setting, one for each row and seed."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

from omniocc.config import dotted
from omniocc.errors import UserError
from omniocc.report.runs import GRID, FinishedRun, grid_kind
from omniocc.runs.folder import OF_MACHINES, VOLATILE, WITHOUT_START, is_clean
from omniocc.runs.results import FINISHED, METRICS, PROTOCOL, says_the_same, utc_text
from omniocc.runs.table import SCORES

ABSENT = object()
REASONS = ("runs of other names", "runs of changed code", "older runs")
"""Runs that do not count beside another one, in the order in which `preference` decides."""
Place = tuple[tuple[str, Any], tuple[str, ...]]
"""Row and seed, and setting, of a run."""
BESIDE_ROW = (*OF_MACHINES, "seed")
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


def comparable(
    runs: Sequence[FinishedRun], setting: tuple[str, ...], rows: Collection[str] = ()
) -> tuple[list[FinishedRun], str]:
    """Return the runs of one preset, number of steps and dataset, and a remark on them and on what is left out.

    Of several runs of a row with one seed that of `best_of` is taken. Runs whose scores were counted by another
    protocol than those of most runs on the same grid are left out, so that no table compares them.

    Args:
        runs: finished runs.
        setting: preset, steps and data.
        rows: those of the tables.
    """
    of_setting = [run for run in runs if run.setting == setting]
    otherwise = counted_otherwise(of_setting, of_setting, rows)
    same = [run for run in of_setting if run.name not in otherwise]
    best = best_of(same)
    kept = [run for run in same if best[run.place, setting] is run]
    commits = sorted({str(run.facts.get("commit", "unknown")) for run in kept})
    name, steps, data = setting
    text = f"preset={name}, {steps} steps, data {data[:8]}, commit {', '.join(commits)}."
    if others := sorted(run.name for run in runs if run.setting != setting):
        text += f" Of another preset, number of steps or dataset: {', '.join(others)}."
    if alike := sorted(f"{run.name} ({run.same_as})" for run in kept if run.same_as):
        text += f" Counted in the row whose configuration they have: {', '.join(alike)}."
    behind = sorted(_replaced(same, best))
    for reason in REASONS:
        if names := [run for why, run in behind if why == reason]:
            text += f" Left out, {reason} of the same row and seed: {', '.join(names)}."
    return kept, text + otherwise_text(of_setting, otherwise)


def best_of(runs: Sequence[FinishedRun]) -> dict[Place, FinishedRun]:
    """Return the run of each row, seed and setting that counts; see `preference`."""
    return {(run.place, run.setting): run for run in sorted(runs, key=preference)}


def preference(run: FinishedRun) -> tuple[bool, bool, tuple[str, str]]:
    """Return what decides which of two runs of a row and seed counts, in this order; the higher one does.

    Its own name is that of the row, its code is that of a commit, it has finished later.
    """
    return run.same_as is None, is_clean(run.facts.get("commit")), _finished(run)


def protocol_of(runs: Sequence[FinishedRun], rows: Collection[str] = ()) -> Mapping[str, str]:
    """Return how runs counted their scores, by kind: as most of those did that count first; empty if none tells.

    First count runs of the `rows` of tables, then those that `preference` takes first.
    """
    told = [run for run in runs if run.facts.get(PROTOCOL)]
    ranks = [(run.row in rows, *preference(run)[:2]) for run in told]
    highest = max(ranks, default=())
    first = [run for run, rank in zip(told, ranks, strict=True) if rank == highest]
    ways = Counter(tuple(sorted(run.facts[PROTOCOL].items())) for run in sorted(first, key=preference, reverse=True))
    return dict(ways.most_common(1)[0][0]) if ways else {}


def counted_otherwise(
    runs: Sequence[FinishedRun], others: Sequence[FinishedRun], rows: Collection[str] = ()
) -> dict[str, list[str]]:
    """Return the kinds of scores that runs counted by another protocol than `others` on the same grid, by run.

    A run, or kind of score, of which no protocol is told differs from none. `rows` as in `protocol_of`.
    """
    kinds = {run.name: grid_kind(run.config) for run in (*runs, *others)}
    told = {
        kind: protocol_of([run for run in others if GRID in (kind, kinds[run.name]) or kinds[run.name] == kind], rows)
        for kind in dict.fromkeys(kinds.values())
    }
    found = {}
    for run in runs:
        protocol = told[kinds[run.name]]
        own = run.facts.get(PROTOCOL, {})
        if differs := [kind for kind, text in own.items() if not says_the_same(protocol.get(kind, text), text)]:
            found[run.name] = differs
    return found


def otherwise_text(runs: Sequence[FinishedRun], found: Mapping[str, Sequence[str]]) -> str:
    """Return a sentence that names the runs that `counted_otherwise` found, and how they counted; empty without any."""
    names = []
    for run in sorted((run for run in runs if run.name in found), key=lambda run: run.name):
        ways = [f"{SCORES.get(kind, kind)}: {run.facts[PROTOCOL][kind]}" for kind in found[run.name]]
        names.append(f"{run.name} ({'; '.join(ways)})")
    return f" Left out, since their scores are counted by another protocol: {', '.join(names)}." if names else ""


def _finished(run: FinishedRun) -> tuple[str, str]:
    """Return when a run finished, and its name; runs that did not record it have the time of their file."""
    path = run.folder / METRICS
    written = path.stat().st_mtime if path.exists() else 0.0
    return run.facts.get(FINISHED) or utc_text(written), run.name


def _replaced(runs: Sequence[FinishedRun], best: Mapping[Place, FinishedRun]) -> Iterator[tuple[str, str]]:
    """Yield why runs do not count in their place, with their names and the keys in which they differ from what does."""
    for run in runs:
        if (other := best[run.place, run.setting]) is not run:
            decides = [ours != theirs for ours, theirs in zip(preference(run), preference(other), strict=True)]
            keys = differences([run, other])
            yield REASONS[decides.index(True)], run.name + (f" (of another {keys} than {other.name})" if keys else "")


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
    versions = [(run.facts.get("commit"), comparable_config(run.config)) for run in runs]
    for (commit, left), (other_commit, right) in combinations(versions, 2):
        keys = left.keys() | right.keys() if commit == other_commit else left.keys() & right.keys()
        found |= {key for key in keys if left.get(key, ABSENT) != right.get(key, ABSENT)}
    keys = sorted(found)
    return f"{', '.join(keys[:4])}{' and more' * (len(keys) > 4)}"


def comparable_config(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configuration without name, seed, machine and `VOLATILE`, by dotted key; equal for runs of one row."""
    values = dotted({key: value for key, value in config.items() if key not in ("name", *VOLATILE)})
    values |= {"resume": given} if (given := config.get("resume")) not in (None, *WITHOUT_START) else {}
    return {key: value for key, value in values.items() if not set(key.split(".")) & set(BESIDE_ROW)}


def given_values(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return `comparable_config` without keys that are null.

    A key that a later commit added and that is null then tells no runs apart.
    """
    return {key: value for key, value in comparable_config(config).items() if value is not None}


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
