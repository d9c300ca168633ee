"""All runs of a report, one line each."""

from omniocc.report.runs import FinishedRun
from omniocc.run.table import band_keys, number


def table_of_runs(runs: list[FinishedRun]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows: run, seed, steps, RayIoU, its distance bands, RayIoU against LiDAR rays, mIoU."""
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
