"""A run's figures as tables, for W&B; classes and distance bands are those of its figures."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from omniocc.runs.table import band_names, class_names


class ResultTable(NamedTuple):
    """Column titles, and rows that begin with a name; None where nothing was measured."""

    columns: list[str]
    rows: list[list[str | float | None]]


BY_CLASS = {
    "voxel RayIoU": "test/rayiou/{}",
    "surface RayIoU": "test/lidar/rayiou/{}",
    "IoU": "test/voxel/iou/{}",
    "baseline: voxel RayIoU": "prior/rayiou/{}",
    "upper bound: surface RayIoU": "label/lidar/rayiou/{}",
}
BY_RANGE = {
    "voxel RayIoU": "test/rayiou_{}",
    "surface RayIoU": "test/lidar/rayiou_{}",
    "baseline: voxel RayIoU": "prior/rayiou_{}",
    "depth: MAE, m": "test/depth/mae_{}",
    "depth: AbsRel": "test/depth/absrel_{}",
    "sketch: recall": "test/sketch/recall_{}",
    "sketch: precision": "test/sketch/precision_{}",
    "sketch: fraction": "test/sketch/fraction_{}",
}


PART = re.compile("robustness/(.+)/rayiou")
BY_PART = {
    "RayIoU": "robustness/{}/rayiou",
    "drop": "robustness/{}/drop",
    "standard error": "robustness/{}/error",
}


def result_tables(metrics: Mapping[str, float]) -> dict[str, ResultTable]:
    """Return the tables of a finished test, with the columns that have a figure.

    They are `tables/by_class`, `tables/by_range` and, of a robustness test, `tables/robustness`.
    """
    parts = [match[1] for key in metrics if (match := PART.fullmatch(key))]
    found = {
        "tables/by_class": _table("class", class_names(metrics), BY_CLASS, metrics),
        "tables/by_range": _table("range", band_names(metrics), BY_RANGE, metrics),
        "tables/robustness": _table("disturbance", parts, BY_PART, metrics),
    }
    return {key: table for key, table in found.items() if len(table.columns) > 1}


def _table(title: str, names: Sequence[str], columns: Mapping[str, str], metrics: Mapping[str, float]) -> ResultTable:
    kept = {head: key for head, key in columns.items() if any(key.format(name) in metrics for name in names)}
    rows: list[list[str | float | None]] = [
        [name, *(_figure(metrics.get(key.format(name))) for key in kept.values())] for name in names
    ]
    return ResultTable([title, *kept], rows)


def _figure(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else float(value)
