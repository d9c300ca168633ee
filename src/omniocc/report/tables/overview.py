"""All runs of a report, one line each."""

from collections.abc import Sequence

from omniocc.report.runs import FinishedRun
from omniocc.run.machine import MACHINE
from omniocc.run.results import EARLIER_MINUTES, MINUTES
from omniocc.run.table import Cells, band_keys, number

RECORDS = ("seed", "steps", MINUTES, EARLIER_MINUTES, "commit", MACHINE)


def overview_keys(runs: Sequence[FinishedRun]) -> list[str]:
    """Return the keys of the figures in `table_of_runs`."""
    bands = band_keys(runs[0].metrics)
    return [f"test/{key}" for key in ("rayiou", *bands, "lidar/rayiou", "voxel/miou")]


def overview_titles(runs: Sequence[FinishedRun]) -> list[str]:
    """Return the titles of `overview_keys`."""
    names = [band.removeprefix("rayiou_") for band in band_keys(runs[0].metrics)]
    return ["RayIoU", *names, "RayIoU, LiDAR", "mIoU"]


def table_of_runs(runs: Sequence[FinishedRun]) -> Cells:
    """Return head and rows: run, seed, steps, RayIoU, its distance bands, RayIoU against LiDAR rays, mIoU."""
    head = ["run", "seed", "steps", *overview_titles(runs)]
    rows = []
    for run in runs:
        facts = [str(run.facts.get(key, "–")) for key in ("seed", "steps")]
        rows.append([run.name, *facts, *(number(run.metrics.get(key)) for key in overview_keys(runs))])
    return head, rows


def records(runs: Sequence[FinishedRun]) -> Cells:
    """Return head and rows of how the runs were made, by name: seed, steps, minutes, commit, machine, command."""
    rows = []
    for run in sorted(runs, key=lambda run: run.name):
        command = "–" if run.command is None else f"`{run.command}`"
        rows.append([run.name, *(str(run.facts.get(key, "–")) for key in RECORDS), command])
    return ["run", "seed", "steps", "minutes", "of earlier stages", "commit", MACHINE, "command"], rows
