"""All finished runs of a folder, side by side."""

from pathlib import Path
from typing import NamedTuple

from omniocc.errors import UserError
from omniocc.report.run import load_results
from omniocc.report.table import band_keys, number
from omniocc.task.run_folder import METRICS


class FinishedRun(NamedTuple):
    """A finished run: its folder's name, its facts and its figures."""

    name: str
    facts: dict
    metrics: dict[str, float]


def read_runs(folder: Path) -> list[FinishedRun]:
    """Finished runs by falling RayIoU.

    Raises:
        UserError: when there is none.
    """
    runs = [FinishedRun(path.parent.name, *load_results(path.parent)) for path in sorted(folder.glob(f"*/{METRICS}"))]
    if not runs:
        raise UserError(f"{folder} holds no finished run ({METRICS}); train one: python src/train.py")
    return sorted(runs, key=lambda run: -run.metrics["test/rayiou"])


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
