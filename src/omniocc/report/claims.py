"""The paper's gaps between methods, and whether they are found here."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from omniocc.report.paper_table import PaperTable, figure_of
from omniocc.report.runs import FinishedRun

CLEAR = 2.0
"""Standard errors from which on a gap is called found."""


class Claim(NamedTuple):
    """How much better the paper's best method of a table is than another one.

    Attributes:
        title: of the other method.
        paper: the gap there.
        here: the gap of the means here.
        error: its standard error; nan as long as no method has two seeds.
    """

    title: str
    paper: float
    here: float
    error: float

    @property
    def verdict(self) -> str:
        """In words, with the number of standard errors; a sign alone where the spread over seeds is unknown."""
        same = self.paper * self.here > 0
        if math.isnan(self.error):
            return f"{'same' if same else 'not the same'} sign (spread unknown)"
        errors = abs(self.here) / self.error if self.error else math.inf
        kind = "cannot be told apart" if errors < CLEAR else "holds" if same else "opposite"
        return f"{kind} ({errors:.1f})"


def pooled_spread(rows: Iterable[Sequence[FinishedRun]], key: str) -> float:
    """Standard deviation over seeds within rows, of all rows together; nan if no row has two seeds.

    Args:
        rows: the runs of each row.
        key: of the metric.
    """
    values = [[value for run in runs if not math.isnan(value := run.metrics.get(key, math.nan))] for runs in rows]
    several = [row for row in values if len(row) > 1]
    freedom = sum(len(row) - 1 for row in several)
    if not freedom:
        return math.nan
    return math.sqrt(sum((len(row) - 1) * statistics.variance(row) for row in several) / freedom)


def claims_of(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> list[Claim]:
    """The gaps of a table that can be looked at here.

    The standard error of a gap between means over n and m seeds is s sqrt(1/n + 1/m), with one s of all rows that
    have run: two or three seeds say little about the spread of one row alone.
    """
    key = table.order_by
    spread = pooled_spread(runs.values(), key)
    measured = {row.run: figure_of(runs.get(row.run, []), key) for row in table.rows}
    printed = [row for row in table.rows if row.paper[key] is not None]
    best = max(printed, key=lambda row: row.paper[key] or 0.0, default=None)
    claims = []
    for row in printed:
        assert best is not None
        ours, theirs = measured[best.run], measured[row.run]
        if row is not best and ours and theirs:
            error = spread * math.sqrt(1 / ours.seeds + 1 / theirs.seeds)
            gap = (best.paper[key] or 0.0) - (row.paper[key] or 0.0)
            claims.append(Claim(row.title, gap, ours.mean - theirs.mean, error))
    return claims


def claim_cells(claims: Sequence[Claim]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of a table of claims."""
    rows = []
    for claim in claims:
        error = "" if math.isnan(claim.error) else f" ± {claim.error:.3f}"
        rows.append([claim.title, f"{claim.paper:+.3f}", f"{claim.here:+.3f}{error}", claim.verdict])
    return ["ahead of", "paper", "here ± standard error", "claim (standard errors)"], rows
