"""What other streets of the test would change in a gap between two rows."""

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from omniocc.report.runs import FinishedRun
from omniocc.runs.scenes import LIDAR, RAYS, SCENES, without_each_scene

KINDS = {"test/rayiou": RAYS, "test/lidar/rayiou": LIDAR}
"""Rays whose counts give a metric, by its key."""


def error_over_streets(better: Sequence[FinishedRun], other: Sequence[FinishedRun], key: str) -> float:
    """Return the standard error of a gap over the streets of the test, for the seeds that were trained.

    It is that of the jackknife: every street is left out of both rows in turn (Efron and Stein, 'The jackknife estimate
    of variance', Annals of Statistics 9, 1981). It is nan if a run has no counts by street, if the rows have other
    streets, or for another metric than RayIoU.
    """
    if key not in KINDS:
        return math.nan
    scores = [_without_each(run.folder / SCENES, KINDS[key]) for run in (*better, *other)]
    streets = sorted(scores[0]) if scores else []
    if len(streets) < 2 or any(sorted(found) != streets for found in scores):
        return math.nan
    values = np.array([[found[street] for street in streets] for found in scores])
    gaps = values[: len(better)].mean(axis=0) - values[len(better) :].mean(axis=0)
    return float(math.sqrt((len(streets) - 1) * gaps.var()))


def _without_each(path: Path, kind: str) -> Mapping[str, float]:
    return _read(path, path.stat().st_mtime_ns, kind) if path.exists() else {}


@functools.cache
def _read(path: Path, modified_ns: int, kind: str) -> Mapping[str, float]:
    """Return the scores without each street of a file as it is since `modified_ns`."""
    return without_each_scene(path.parent, kind)
