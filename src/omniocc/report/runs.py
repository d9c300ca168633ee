"""All finished runs of a folder, side by side."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from omniocc.errors import UserError
from omniocc.report.run import load_results
from omniocc.report.table import band_keys, number
from omniocc.task.run_folder import METRICS

HASH = re.compile(r"-[0-9a-f]{8}(-\d+)?$")


class FinishedRun(NamedTuple):
    """A finished run: its folder's name, its facts and its figures."""

    name: str
    facts: dict
    metrics: dict[str, float]

    @property
    def row(self) -> str:
        """The name it was given: that of its row in the tables."""
        return HASH.sub("", self.name)

    @property
    def setting(self) -> tuple[str, ...]:
        """What runs must have in common to be compared."""
        return tuple(str(self.facts.get(key, "unknown")) for key in ("preset", "steps", "data"))


def read_runs(folder: Path) -> list[FinishedRun]:
    """Finished runs by falling RayIoU.

    Raises:
        UserError: when there is none.
    """
    runs = [FinishedRun(path.parent.name, *load_results(path.parent)) for path in sorted(folder.glob(f"*/{METRICS}"))]
    if not runs:
        raise UserError(f"{folder} holds no finished run ({METRICS}); train one: python src/train.py")
    return sorted(runs, key=lambda run: -run.metrics["test/rayiou"])


def comparable(runs: Sequence[FinishedRun], preset: str | None) -> tuple[list[FinishedRun], str]:
    """The runs of one preset, number of steps and dataset, and a sentence on what they are and what is left out.

    Args:
        runs: at least one.
        preset: theirs; None takes the setting that most runs have.

    Raises:
        UserError: when no run has that preset.
    """
    candidates = [run for run in runs if preset in (None, run.facts.get("preset"))]
    if not candidates:
        found = sorted({str(run.facts.get("preset", "unknown")) for run in runs})
        raise UserError(f"no finished run of preset {preset}; there are runs of {', '.join(found)}")
    chosen = Counter(run.setting for run in candidates).most_common(1)[0][0]
    kept = [run for run in candidates if run.setting == chosen]
    others = sorted(run.name for run in runs if run.setting != chosen)
    commits = sorted({str(run.facts.get("commit", "unknown")) for run in kept})
    name, steps, data = chosen
    text = f"preset={name}, {steps} steps, data {data[:8]}, commit {', '.join(commits)}."
    return kept, text + (f" Left out, of another setting: {', '.join(others)}." if others else "")


def by_row(runs: Sequence[FinishedRun]) -> dict[str, list[FinishedRun]]:
    """Runs of each row of the tables.

    Raises:
        UserError: when a row has two runs with the same seed, since then they differ in something else.
    """
    rows: dict[str, list[FinishedRun]] = {}
    for run in runs:
        rows.setdefault(run.row, []).append(run)
    for row, members in rows.items():
        seed, times = Counter(run.facts.get("seed") for run in members).most_common(1)[0]
        if times > 1:
            names = ", ".join(run.name for run in members if run.facts.get("seed") == seed)
            raise UserError(f"row {row} has {times} runs with seed {seed} ({names}); move all but one elsewhere")
    return rows


def table_of_runs(runs: list[FinishedRun]) -> tuple[list[str], list[list[str]]]:
    """Head and rows: run, seed, steps, RayIoU, its distance bands, RayIoU against LiDAR rays, mIoU."""
    bands = band_keys(runs[0].metrics)
    head = [
        "run",
        "seed",
        "steps",
        "RayIoU",
        *(band.removeprefix("rayiou_") for band in bands),
        "RayIoU, LiDAR",
        "mIoU",
    ]
    keys = ["rayiou", *bands, "lidar/rayiou", "voxel/miou"]
    rows = [
        [
            run.name,
            str(run.facts.get("seed", "–")),
            str(run.facts.get("steps", "–")),
            *(number(run.metrics.get(f"test/{key}")) for key in keys),
        ]
        for run in runs
    ]
    return head, rows
