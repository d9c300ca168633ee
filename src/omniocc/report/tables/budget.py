"""What each row was given and what it costs, so that equal budgets can be checked; and what scores can be."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from omniocc.report.runs import FinishedRun
from omniocc.run.cost import GFLOP, PARAMETERS, PEAK
from omniocc.run.table import number

HEAD = [
    "row",
    "M parameters",
    "GFLOP a frame",
    "steps of depth",
    "of the sketch",
    "of the model",
    "samples a step",
    "minutes",
    "peak MiB",
]
BUDGET_NOTE = (
    "Parameters and operations are of the whole system, depth and sketch included; minutes and memory are of the last "
    "stage, whose steps and samples all rows share. Rows with a learned sketch have had two stages before it."
)
YARDSTICKS_NOTE = (
    "prior: the most frequent training class of every voxel, what a model knows that never opens its eyes. label: the "
    "true voxels; against LiDAR rays the highest score that the grid allows."
)
YARDSTICKS = ["grid", "prior: RayIoU", "prior: LiDAR", "label: RayIoU", "label: LiDAR"]


def budget_cells(rows: Mapping[str, Sequence[FinishedRun]]) -> tuple[list[str], list[list[str]]]:
    """Head and a line for each row.

    Parameters and operations are those of the whole system, depth and sketch included; minutes (mean over seeds) and
    memory (the most of any seed) those of the last stage.
    """
    return HEAD, [[row, *_budget(runs)] for row, runs in rows.items()]


def _budget(runs: Sequence[FinishedRun]) -> Iterator[str]:
    yield _told(runs, PARAMETERS, "{:.2f}", max)
    yield _told(runs, GFLOP, "{:.3g}", max)
    stages = runs[0].config.get("stages", {}) if "depth" in runs[0].config.get("model", {}).get("sketch", {}) else {}
    for stage in ("depth", "sketch"):
        yield str(stages.get(stage, {}).get("max_steps", "–"))
    yield str(runs[0].facts.get("steps", "–"))
    yield str(runs[0].config.get("data", {}).get("batch_size", "–"))
    yield _told(runs, "minutes of training", "{:.1f}", lambda values: sum(values) / len(values))
    yield _told(runs, PEAK, "{:.0f}", max)


def _told(runs: Sequence[FinishedRun], key: str, form: str, of_seeds: Callable[[list[float]], float]) -> str:
    values = [float(run.facts[key]) for run in runs if run.facts.get(key) is not None]
    return form.format(of_seeds(values)) if values else "–"


def yardstick_cells(rows: Mapping[str, Sequence[FinishedRun]]) -> tuple[list[str], list[list[str]]]:
    """Head and a line for each grid: what needs no eyes, and what no prediction on this grid can exceed."""
    grids = {_grid(run): run for runs in rows.values() for run in runs[:1]}
    keys = ("prior/rayiou", "prior/lidar/rayiou", "label/rayiou", "label/lidar/rayiou")
    lines = [[grid, *(number(run.metrics.get(key)) for key in keys)] for grid, run in grids.items()]
    return YARDSTICKS, lines


def _grid(run: FinishedRun) -> str:
    geometry = run.config.get("model", {}).get("geometry", {})
    kind = str(geometry.get("_target_", "unknown")).rsplit(".", 1)[-1].lower()
    return " ".join([kind, "x".join(map(str, geometry.get("shape", [])))]).strip()
