"""Gaps between rows in one metric, with standard errors over seeds."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from omniocc.report.runs import FinishedRun

EXACT = 1e-9
"""Standard error below which all runs agree."""
RANGE_ERROR = "test/depth/mae"
"""Mean range error: two runs of a seed have the same one only if they use the same depth network."""


class Gap(NamedTuple):
    """A difference between two rows.

    Attributes:
        here: the difference; nan if it cannot be measured.
        error: its standard error; nan if there are too few seeds to estimate it.
        freedom: degrees of freedom of the error.
    """

    here: float
    error: float
    freedom: float

    @property
    def written(self) -> str:
        """Return the gap with its standard error for a table."""
        if math.isnan(self.here):
            return "–"
        return f"{self.here:+.3f}" + ("" if math.isnan(self.error) else f" ± {self.error:.3f}")

    @property
    def p_none(self) -> float:
        """Return the two-sided p-value of 'there is no gap'; nan if the error is not known."""
        if self.error < EXACT:
            return float(abs(self.here) < EXACT)
        return 2 * float(stdtr(self.freedom, -abs(self.here) / self.error))


UNKNOWN = Gap(math.nan, math.nan, 0)


def gap_of_systems(better: Sequence[FinishedRun], other: Sequence[FinishedRun], key: str) -> Gap:
    """Return the gap between two rows that are trained on their own: Welch's t, for two samples of unequal variance.

    The error is unknown if one of them has a single seed: the other's standard deviation says nothing about it.
    """
    samples = [np.array([value for _, value in _figures(runs, key)]) for runs in (better, other)]
    if not all(len(sample) for sample in samples):
        return UNKNOWN
    here = float(samples[0].mean() - samples[1].mean())
    if min(map(len, samples)) < 2:
        return Gap(here, math.nan, 0)
    squares = [float(sample.var(ddof=1)) / len(sample) for sample in samples]
    return Gap(here, *_combined(squares, [len(sample) - 1 for sample in samples]))


def paired_gap(better: Sequence[FinishedRun], other: Sequence[FinishedRun], key: str) -> Gap:
    """Return the mean difference over the seeds that two rows have in common: the paired t-test.

    A seed on other data, or with another depth network, is another seed. The error is unknown with a single seed, the
    gap too without one.
    """
    first, second = ({_seed_of(run): value for run, value in _figures(runs, key)} for runs in (better, other))
    differences = np.array([value - second[seed] for seed, value in first.items() if seed in second])
    if not len(differences):
        return UNKNOWN
    error = float(differences.std(ddof=1)) / math.sqrt(len(differences)) if len(differences) > 1 else math.nan
    return Gap(float(differences.mean()), error, len(differences) - 1)


def change(first: Gap, last: Gap) -> Gap:
    """Return how far a gap has moved, as if the two had no noise in common; degrees of freedom by Satterthwaite."""
    squares = [gap.error * gap.error for gap in (first, last)]
    return Gap(last.here - first.here, *_combined(squares, [first.freedom, last.freedom]))


def _combined(squares: Sequence[float], freedoms: Sequence[float]) -> tuple[float, float]:
    """Return the error of a sum of independent terms, and its degrees of freedom by Satterthwaite."""
    square = sum(squares)
    parts = sum(each * each / freedom for each, freedom in zip(squares, freedoms, strict=True) if freedom)
    return math.sqrt(square), square * square / parts if parts else sum(freedoms)


def _figures(runs: Sequence[FinishedRun], key: str) -> list[tuple[FinishedRun, float]]:
    return [(run, value) for run in runs if not math.isnan(value := run.metrics.get(key, math.nan))]


def _seed_of(run: FinishedRun) -> tuple:
    """Return data, seed and mean range error (six digits; None without a depth network), equal for runs of one seed."""
    error_m = run.metrics.get(RANGE_ERROR)
    return run.facts.get("data"), run.facts.get("seed"), None if error_m is None else f"{error_m:.6g}"


class Gaps:
    """Gaps between rows that share the stages of a seed, with the effect of the seed removed.

    A figure is modelled as the sum of an effect of its row, an effect of its seed and noise (least squares over all
    runs), since rows share depth, sketch and order of samples of a seed. For two rows with the same seeds this is the
    paired t-test; a row that lacks a seed is compared on those it has. The noise has one variance in all rows, because
    two or three seeds are too few to estimate it for each. A seed on other data is another seed, and so is one
    whose depth network was trained again on another machine, which gives slightly different weights.

    Args:
        rows: the runs of each row.
        key: key of the metric; runs without it do not count.

    Attributes:
        freedom: degrees of freedom of the noise; 0 if no row has a second seed.
        std: standard deviation of the noise; nan if no row has a second seed.
    """

    def __init__(self, rows: Mapping[str, Sequence[FinishedRun]], key: str):
        entries = [(row, _seed_of(run), value) for row, runs in rows.items() for run, value in _figures(runs, key)]
        self._place: dict[tuple, int] = {}
        for row, *_ in entries:
            self._place.setdefault(("row", row), len(self._place))
        for _, seed, _ in entries:
            self._place.setdefault(("seed", seed), len(self._place))
        self._design = np.zeros((len(entries), len(self._place)))
        for line, (row, seed, _) in enumerate(entries):
            self._design[line, [self._place["row", row], self._place["seed", seed]]] = 1
        values = np.array([value for *_, value in entries])
        self._inverse = np.linalg.pinv(self._design)
        self._effects = self._inverse @ values
        self.freedom = len(entries) - int(np.linalg.matrix_rank(self._design)) if entries else 0
        left = float(np.square(values - self._design @ self._effects).sum())
        self.std = math.sqrt(left / self.freedom) if self.freedom else math.nan

    def has(self, row: str) -> bool:
        """Return whether the row has a figure."""
        return ("row", row) in self._place

    def between(self, better: str, other: str) -> Gap:
        """Return the gap between two rows.

        It is unknown if a row has not run, or the rows have no seeds in common, directly or through others.
        """
        if not (self.has(better) and self.has(other)):
            return UNKNOWN
        contrast = np.zeros(len(self._place))
        contrast[self._place["row", better]], contrast[self._place["row", other]] = 1, -1
        weights = contrast @ self._inverse
        if not np.allclose(weights @ self._design, contrast):
            return UNKNOWN
        error = self.std * math.sqrt(float(weights @ weights))
        return Gap(float(contrast @ self._effects), error, self.freedom)


def holm(p_values: Sequence[float], tests: int = 0) -> list[float]:
    """Return p-values adjusted for their number, or for `tests` where more are planned than done, in the same order.

    A p-value that is nan is not known; it stays, and counts only among `tests`.

    Rejecting all hypotheses whose adjusted p-value is below alpha keeps the probability of one wrong rejection or more
    below alpha, whatever the tests have in common. Holm, 'A simple sequentially rejective multiple test procedure',
    Scandinavian Journal of Statistics 6, 1979.

    Example:
        >>> [round(p, 3) for p in holm([0.01, 0.04, 0.03])]
        [0.03, 0.06, 0.06]
    """
    adjusted, largest = [math.nan] * len(p_values), 0.0
    order = sorted((k for k, p_value in enumerate(p_values) if not math.isnan(p_value)), key=lambda k: p_values[k])
    tests = max(tests, len(order))
    for rank, place in enumerate(order):
        largest = max(largest, min(1.0, (tests - rank) * p_values[place]))
        adjusted[place] = largest
    return adjusted
