"""The records of finished runs without their checkpoints and images, small enough for a repository."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from omniocc.io import atomic_write
from omniocc.report.runs import TRAINING, VALIDATION, FinishedRun, read_runs
from omniocc.report.selection import best_of, preference
from omniocc.report.tables.formats import csv_text
from omniocc.runs.curves import CURVES, read_rows
from omniocc.runs.results import FROM_TRAJECTORY, METRICS
from omniocc.runs.robustness import TESTS
from omniocc.runs.scenes import SCENES

KEPT = ("config.yaml", METRICS, SCENES, CURVES, TESTS, f"{FROM_TRAJECTORY}/{METRICS}")
"""Files, or patterns of files, of a run from which every table and curve can be written again."""


def keep_records(runs: Path, folder: Path) -> list[Path]:
    """Copy the configuration, figures, curves and later tests of finished runs and return their new folders.

    Of several runs of one row, seed and setting that of `best_of` is copied. Later tests are those from other origins
    of rays and those under disturbances; tests of weights that have no run are copied and returned too. Runs of an
    earlier call stay, but for those that a run of this call replaces, whichever finished later: one of the same row,
    seed and setting, which is not of changed code while theirs is that of a commit. Where a run has been trained again
    since, the later tests of its former weights go as well.

    Raises:
        UserError: when there is neither a finished run nor such a test.
        DataError: naming the file that cannot be written.
    """
    tests = sorted(runs.glob(TESTS))
    for path in tests:
        atomic_write(folder / path.relative_to(runs), path.read_bytes())
    kept = [folder / path.parent.name for path in tests]
    if kept and not any(runs.glob(f"*/{METRICS}")):
        return kept
    found, before = read_runs(runs), read_runs(folder) if any(folder.glob(f"*/{METRICS}")) else []
    best, stays = best_of(found), best_of(before)
    finished = [
        run
        for run in found
        if best[run.place, run.setting] is run
        and preference(stays.get((run.place, run.setting), run))[:2] <= preference(run)[:2]
    ]
    for run in finished:
        copy = folder / run.name
        if copy.exists() and _figures(copy) != _figures(run.folder):
            shutil.rmtree(copy)
        for pattern in KEPT:
            for path in run.folder.glob(pattern):
                content = drawn_curves(path) if pattern == CURVES else path.read_bytes()
                atomic_write(copy / path.relative_to(run.folder), content)
    for path in replaced(read_runs(folder), finished):
        shutil.rmtree(path)
    return [*(folder / run.name for run in finished), *kept]


def drawn_curves(path: Path) -> str:
    """Return a CSV file of a run's curves with the columns alone that reports draw, from its first line on."""
    columns = ("step", TRAINING, VALIDATION)
    rows = [[row.get(key, "") for key in columns] for row in read_rows(path)]
    return csv_text(columns, [row for number, row in enumerate(rows) if number == 0 or any(row[1:])])


def _figures(run: Path) -> bytes:
    """Return the file with the figures of a run, which no two trainings have in common; empty if there is none."""
    path = run / METRICS
    return path.read_bytes() if path.exists() else b""


def replaced(kept: Sequence[FinishedRun], newer: Sequence[FinishedRun]) -> list[Path]:
    """Return the folders of kept runs that have the row, seed and setting of a newer run of another name."""
    names, places = {run.name for run in newer}, {(run.place, run.setting) for run in newer}
    return [run.folder for run in kept if run.name not in names and (run.place, run.setting) in places]
