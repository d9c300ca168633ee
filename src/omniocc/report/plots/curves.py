"""Training curves of several seeds as one, and smoothed."""

import statistics
from collections.abc import Sequence
from typing import NamedTuple


class Curve(NamedTuple):
    """Mean, lowest and highest value over seeds, at each step recorded for all seeds."""

    steps: list[int]
    mean: list[float]
    low: list[float]
    high: list[float]


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
