"""All runs of a report, one line each."""

from collections.abc import Sequence

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.budget import steps_of_stages
from omniocc.report.tables.formats import csv_text, exact
from omniocc.runs.cost import PEAK
from omniocc.runs.machine import MACHINE
from omniocc.runs.results import EARLIER_MINUTES, MINUTES
from omniocc.runs.table import SURFACE_RAYIOU, VOXEL_RAYIOU, Cells, band_keys, number

FACTS = {
    "seed": "seed",
    "preset": "preset",
    "data": "fingerprint of the data",
    "steps": "steps",
    MINUTES: "minutes",
    EARLIER_MINUTES: "minutes of depth and sketch",
    PEAK: "peak memory, MiB",
    "commit": "commit",
    MACHINE: "machine",
}
"""Titles of recorded facts."""


def overview_keys(runs: Sequence[FinishedRun]) -> list[str]:
    """Return the keys of the figures in `table_of_runs`."""
    bands = band_keys(runs[0].metrics)
    return [f"test/{key}" for key in ("rayiou", *bands, "lidar/rayiou", "voxel/miou")]


def table_of_runs(runs: Sequence[FinishedRun]) -> Cells:
    """Return head and rows: run, seed, steps, voxel RayIoU, its distance bands, surface RayIoU, mIoU."""
    names = [band.removeprefix("rayiou_") for band in band_keys(runs[0].metrics)]
    head = ["run", "seed", "steps", VOXEL_RAYIOU, *names, SURFACE_RAYIOU, "mIoU"]
    rows = []
    for run in runs:
        facts = [str(run.facts.get(key, "–")) for key in ("seed", "steps")]
        rows.append([run.name, *facts, *(number(run.metrics.get(key)) for key in overview_keys(runs))])
    return head, rows


def records(runs: Sequence[FinishedRun]) -> str:
    """Return CSV of how runs were made and what they scored, by name."""
    bands = list(dict.fromkeys(key for run in runs for key in band_keys(run.metrics)))
    scores = {"rayiou": VOXEL_RAYIOU, **{key: f"{VOXEL_RAYIOU}, {key.partition('_')[2]}" for key in bands}}
    scores |= {"lidar/rayiou": SURFACE_RAYIOU, "voxel/iou": "IoU", "voxel/miou": "mIoU"}
    lines = []
    for run in sorted(runs, key=lambda run: run.name):
        facts = [str(run.facts.get(key, "")) for key in FACTS]
        known = [exact(run.metrics.get(f"test/{key}")) for key in scores]
        lines.append([run.name, run.row, *facts, steps_of_stages(run), *known, run.command or ""])
    head = ["run", "row", *FACTS.values(), "steps of depth, sketch and occupancy", *scores.values(), "command"]
    return csv_text(head, lines)
