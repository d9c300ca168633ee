"""The paper's gaps between methods, and whether they are found here."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from omniocc.report.paper_table import PaperTable, figure_of
from omniocc.report.runs import FinishedRun

RAYIOU, LIDAR = "test/rayiou", "test/lidar/rayiou"
STUDENT = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23)
"""Standard errors from which on a gap is called found: Student's t, two-sided 95 %, at 1, 2, ... degrees of freedom.

With more it keeps to the last, which is a little strict.
"""


class Claim(NamedTuple):
    """How much better the paper's best method of a table is than another one.

    Attributes:
        title: of the other method.
        paper: the gap there.
        here: the gap of the means here.
        error: its standard error; nan as long as no method has two seeds.
        freedom: degrees of freedom of the spread behind it.
    """

    title: str
    paper: float
    here: float
    error: float
    freedom: int

    @property
    def gap(self) -> str:
        """What was measured, with its standard error."""
        return f"{self.here:+.3f}" + ("" if math.isnan(self.error) else f" ± {self.error:.3f}")

    @property
    def verdict(self) -> str:
        """In words, with the number of standard errors; a sign alone where the spread over seeds is unknown."""
        same = self.paper * self.here > 0
        if math.isnan(self.error):
            return f"{'same' if same else 'not the same'} sign (spread unknown)"
        errors = abs(self.here) / self.error if self.error else math.inf
        kind = (
            "cannot be told apart"
            if errors < STUDENT[min(self.freedom, len(STUDENT)) - 1]
            else "holds"
            if same
            else "opposite"
        )
        return f"{kind} ({errors:.1f})"


def pooled_spread(rows: Iterable[Sequence[FinishedRun]], key: str) -> tuple[float, int]:
    """Standard deviation over seeds within rows, of all rows together, and its degrees of freedom.

    It is nan if no row has two seeds.

    Args:
        rows: the runs of each row.
        key: of the metric.
    """
    values = [[value for run in runs if not math.isnan(value := run.metrics.get(key, math.nan))] for runs in rows]
    several = [row for row in values if len(row) > 1]
    freedom = sum(len(row) - 1 for row in several)
    if not freedom:
        return math.nan, 0
    return math.sqrt(sum((len(row) - 1) * statistics.variance(row) for row in several) / freedom), freedom


def claims_of(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]], key: str) -> list[Claim]:
    """The gaps of a table that can be looked at here.

    The standard error of a gap between means over n and m seeds is s sqrt(1/n + 1/m), with one s of all rows that
    have run: two or three seeds say little about the spread of one row alone.

    Args:
        table: gives the paper's gaps, in the metric that it is ordered by.
        runs: of each row.
        key: of the metric that is compared here.
    """
    spread, freedom = pooled_spread(runs.values(), key)
    measured = {row.run: figure_of(runs.get(row.run, []), key) for row in table.rows}
    printed = [(row, value) for row in table.rows if (value := row.paper[table.order_by]) is not None]
    best, most = max(printed, key=lambda entry: entry[1], default=(None, 0.0))
    claims = []
    for row, value in printed:
        assert best is not None
        ours, theirs = measured[best.run], measured[row.run]
        if row is not best and ours and theirs:
            error = spread * math.sqrt(1 / ours.seeds + 1 / theirs.seeds)
            claims.append(Claim(row.title, most - value, ours.mean - theirs.mean, error, freedom))
    return claims


def claim_cells(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of a table of claims; also against LiDAR rays, where the paper's metric is RayIoU."""
    claims = claims_of(table, runs, table.order_by)
    lidar = claims_of(table, runs, LIDAR) if table.order_by == RAYIOU else []
    head = ["best of the paper is ahead of", "paper", "here ± standard error", "claim (standard errors)"]
    rows = [[claim.title, f"{claim.paper:+.3f}", claim.gap, claim.verdict] for claim in claims]
    if claims and [claim.title for claim in lidar] == [claim.title for claim in claims]:
        head += ["LiDAR", "claim"]
        rows = [[*row, claim.gap, claim.verdict] for row, claim in zip(rows, lidar, strict=True)]
    return head, rows
