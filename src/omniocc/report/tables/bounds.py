"""What scores on each grid are measured by: a baseline that needs no image, and the true voxels."""

from collections.abc import Mapping, Sequence

from omniocc.report.runs import FinishedRun, grid_name
from omniocc.runs.table import SCORES, Cells, number

TITLE = "Baseline and upper bound"
NOTE = (
    "Baseline: the most frequent training class of every voxel, which needs no image. Upper bound: the true voxels, "
    "scored as if predicted. Its surface RayIoU shows what the cells of the grid lose. A prediction can score a little "
    "more in a class, since the class with the most points in a cell is not what every ray meets there."
)
COLUMNS = {
    f"{title}, {SCORES[kind]}": f"{row}/{kind}"
    for row, title in {"prior": "Baseline", "label": "Upper bound"}.items()
    for kind in ("rayiou", "lidar/rayiou")
}


def bounds_cells(rows: Mapping[str, Sequence[FinishedRun]]) -> Cells:
    """Return the head and a line for each grid, with RayIoU of the baseline and of the true voxels."""
    grids = {grid_name(run.config): run for runs in rows.values() for run in runs[:1]}
    lines = [[grid, *(number(run.metrics.get(key)) for key in COLUMNS.values())] for grid, run in grids.items()]
    return ["Grid", *COLUMNS], lines
