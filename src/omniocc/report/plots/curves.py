"""Training curves, read from the CSV files that every run writes."""

import csv
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

CURVES = "csv/version_*/metrics.csv"
"""Files of logged metrics in the folder of a run, one for each start."""


class Curve(NamedTuple):
    """Mean, lowest and highest value over seeds, at each step recorded for all seeds."""

    steps: list[int]
    mean: list[float]
    low: list[float]
    high: list[float]


def read_curve(folder: Path, key: str) -> dict[int, float]:
    """Return the values of a logged metric by optimizer step.

    A resumed run has one file for each start; where they overlap, the later file is used, since the run continued from
    an earlier checkpoint. Without CSV files in the run's folder the result is empty.
    """
    curve: dict[int, float] = {}
    for path in sorted(folder.glob(CURVES), key=lambda path: int(path.parent.name.split("_")[1])):
        with path.open(newline="") as file:
            lines = [line for line in csv.DictReader(file) if line.get("step")]
        began = min((int(line["step"]) for line in lines), default=0)
        curve = {step: value for step, value in curve.items() if step < began}
        curve |= {int(line["step"]): float(line[key]) for line in lines if line.get(key)}
    return curve


def over_seeds(curves: Sequence[dict[int, float]]) -> Curve:
    """Return the curves of several seeds as one."""
    steps = sorted(set.intersection(*(set(curve) for curve in curves))) if curves else []
    values = [[curve[step] for curve in curves] for step in steps]
    return Curve(steps, [statistics.mean(v) for v in values], [min(v) for v in values], [max(v) for v in values])


def smoothed(curve: dict[int, float], window: int = 5) -> dict[int, float]:
    """Return the moving mean over `window` values, fewer at the ends."""
    steps, half = sorted(curve), window // 2
    return {
        step: statistics.mean(curve[near] for near in steps[max(0, k - half) : k + half + 1])
        for k, step in enumerate(steps)
    }
