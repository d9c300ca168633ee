"""All runs of a report, one line each."""

from omniocc.report.runs import FinishedRun
from omniocc.run.table import band_keys, number


def table_of_runs(runs: list[FinishedRun]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows: run, seed, steps, RayIoU, its distance bands, RayIoU against LiDAR rays, mIoU."""
    bands = band_keys(runs[0].metrics)
    names = [band.removeprefix("rayiou_") for band in bands]
    head = ["run", "seed", "steps", "RayIoU", *names, "RayIoU, LiDAR", "mIoU"]
    keys = ["rayiou", *bands, "lidar/rayiou", "voxel/miou"]
    rows = []
    for run in runs:
        facts = [str(run.facts.get(key, "–")) for key in ("seed", "steps")]
        rows.append([run.name, *facts, *(number(run.metrics.get(f"test/{key}")) for key in keys)])
    return head, rows
