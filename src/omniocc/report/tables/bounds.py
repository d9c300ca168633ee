"""Limits of scores on each grid: a baseline that needs no image, and the upper bound of the grid."""

from collections.abc import Mapping, Sequence

from omniocc.report.runs import FinishedRun, grid_name
from omniocc.run.table import number

TITLE = "Baseline and upper bound"
NOTE = (
    "prior, the baseline: the most frequent training class of every voxel, which needs no image. label, the upper "
    "bound: the true voxels; against LiDAR rays no prediction on this grid can score more."
)
COLUMNS = {
    "prior: RayIoU": "prior/rayiou",
    "prior: LiDAR": "prior/lidar/rayiou",
    "label: RayIoU": "label/rayiou",
    "label: LiDAR": "label/lidar/rayiou",
}


def bounds_cells(rows: Mapping[str, Sequence[FinishedRun]]) -> tuple[list[str], list[list[str]]]:
    """Return the head and a line for each grid, with RayIoU of its baseline and its upper bound."""
    grids = {grid_name(run.config): run for runs in rows.values() for run in runs[:1]}
    lines = [[grid, *(number(run.metrics.get(key)) for key in COLUMNS.values())] for grid, run in grids.items()]
    return ["grid", *COLUMNS], lines
