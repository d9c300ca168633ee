"""The paper's gaps between methods, compared with ours."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.paper import PaperTable

RAYIOU, LIDAR = "test/rayiou", "test/lidar/rayiou"
CONFIDENCE = 0.95
"""Two-sided confidence with which a gap must differ from zero to be reproduced."""


class Claim(NamedTuple):
    """The gap between the paper's best method of a table and another one.

    Attributes:
        paper: gap in the paper.
        here: gap here, as `Gaps` estimates it; nan if no seed connects the two methods.
        error: standard error of `here`; nan as long as no method has two seeds.
        freedom: degrees of freedom of the error.
    """

    title: str
    paper: float
    here: float
    error: float
    freedom: int

    @property
    def gap(self) -> str:
        """Return the measured gap with its standard error."""
        if math.isnan(self.here):
            return "–"
        return f"{self.here:+.3f}" + ("" if math.isnan(self.error) else f" ± {self.error:.3f}")

    @property
    def verdict(self) -> str:
        """Return whether the claim holds, with the number of standard errors; only by sign where they are unknown."""
        if math.isnan(self.here):
            return "no seed in common"
        same = self.paper * self.here > 0
        if math.isnan(self.error):
            return f"{'same' if same else 'not the same'} sign (spread unknown)"
        errors = abs(self.here) / self.error if self.error > 1e-9 else math.inf
        if errors < stats.t.ppf((1 + CONFIDENCE) / 2, self.freedom):
            return f"cannot be told apart ({errors:.1f})"
        return f"{'holds' if same else 'opposite'} ({errors:.1f})"


class Gaps:
    """Differences between rows in one metric, with the effect of the seed removed.

    A figure is modelled as the sum of an effect of its row, an effect of its seed and noise (least squares over all
    runs), since rows share depth, sketch and order of samples of a seed. For two rows with the same seeds this is the
    paired t-test; a row that lacks a seed is compared on those it has. The noise has one variance in all rows, because
    two or three seeds are too few to estimate it for each.

    Args:
        rows: the runs of each row.
        key: key of the metric; runs without it do not count.

    Attributes:
        freedom: degrees of freedom of the noise; 0 if no row has a second seed.
    """

    def __init__(self, rows: Mapping[str, Sequence[FinishedRun]], key: str):
        entries = [
            (row, str(run.facts.get("seed")), value)
            for row, runs in rows.items()
            for run in runs
            if not math.isnan(value := run.metrics.get(key, math.nan))
        ]
        self._place = {name: k for k, name in enumerate(dict.fromkeys(("row", row) for row, *_ in entries))}
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
        self._spread = math.sqrt(left / self.freedom) if self.freedom else math.nan

    def has(self, row: str) -> bool:
        """Return whether the row has a figure."""
        return ("row", row) in self._place

    def between(self, better: str, other: str) -> tuple[float, float]:
        """Return the gap between two rows and its standard error, which is nan where no row has two seeds.

        Both are nan if a row has not run, or the rows have no seeds in common, directly or through others.
        """
        if not (self.has(better) and self.has(other)):
            return math.nan, math.nan
        contrast = np.zeros(len(self._place))
        contrast[self._place["row", better]], contrast[self._place["row", other]] = 1, -1
        weights = contrast @ self._inverse
        if not np.allclose(weights @ self._design, contrast):
            return math.nan, math.nan
        return float(contrast @ self._effects), self._spread * math.sqrt(float(weights @ weights))


def claims_of(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]], key: str) -> list[Claim]:
    """Return the paper's gaps of a table between methods that have run here.

    Args:
        table: table with the paper's gaps, in the metric that it is ordered by.
        runs: runs of each row; rows that are not in the table improve the estimate of the noise.
        key: key of the metric that is compared here.
    """
    gaps = Gaps(runs, key)
    printed = [(row, value) for row in table.rows if (value := row.paper[table.order_by]) is not None]
    best, most = max(printed, key=lambda entry: entry[1], default=(None, 0.0))
    claims = []
    for row, value in printed:
        assert best is not None
        if row is not best and gaps.has(best.run) and gaps.has(row.run):
            here, error = gaps.between(best.run, row.run)
            claims.append(Claim(row.title, most - value, here, error, gaps.freedom))
    return claims


def claim_cells(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of a table of claims; also against LiDAR rays, where the paper's metric is RayIoU."""
    claims = claims_of(table, runs, table.order_by)
    lidar = claims_of(table, runs, LIDAR) if table.order_by == RAYIOU else []
    head = ["best of the paper is ahead of", "paper", "here ± standard error", "claim (standard errors)"]
    rows = [[claim.title, f"{claim.paper:+.3f}", claim.gap, claim.verdict] for claim in claims]
    if claims and [claim.title for claim in lidar] == [claim.title for claim in claims]:
        head += ["LiDAR", "claim"]
        rows = [[*row, claim.gap, claim.verdict] for row, claim in zip(rows, lidar, strict=True)]
    return head, rows
