"""The same claims after more steps, side by side, and the learning curves."""

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from omniocc.report.runs import VALIDATION, FinishedRun
from omniocc.report.sweep import Sweep
from omniocc.report.tables.claims import (
    JUDGES,
    LEVEL,
    Judged,
    metric_of,
    name_of,
    p_cell,
    pairs_of,
    planned_claims,
    title_of,
)
from omniocc.report.tables.formats import Part, csv_text, exact
from omniocc.report.tables.gaps import Gap, change, holm
from omniocc.report.tables.paper import SPREAD, PaperRow, PaperTable, figure_of, spread_cells
from omniocc.runs.table import Cells

TITLE = "What changes with more steps"
CHANGES = (
    "Claims whose two methods have both run with several numbers of steps. Each number of steps is a family of its "
    "own for Holm's correction. A verdict can also differ because one number of steps has more seeds. Therefore the "
    "change of the gap, from the fewest to the most steps, is tested itself: as if the runs of both had no noise in "
    "common, with Holm's correction over as many claims as a family has. Where scores rise with training, gaps rise "
    "with them."
)
CURVES_TITLE = "Learning curves"
CURVES = (
    "Voxel RayIoU on validation scenes during training, mean over seeds. The learning rate falls to the end of all "
    "steps, so that the beginning of a long run is not a short run."
)
Planned = tuple[PaperTable, PaperRow, PaperRow]
"""A claim that the first method is ahead of the second."""
RunsByRow = Mapping[str, Mapping[str, Sequence[FinishedRun]]]
"""Runs by row and number of steps."""
PARTS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Parts of all steps after which a training is validated by default."""


class Compared(NamedTuple):
    """A claim in one metric, as it was decided at each number of steps; None where it was not."""

    title: str
    judge: str
    found: Sequence[Judged | None]

    @property
    def change(self) -> Gap:
        """Return how far the gap moves from the fewest to the most steps."""
        first, *_, last = (found for found in self.found if found is not None)
        return change(first.claim.gap, last.claim.gap)


def changes_part(sweep: Sweep) -> list[Part]:
    """Return the table of claims of a sweep and of its `longer` ones; none without a claim decided in two of them."""
    sweeps = by_steps(sweep)
    claims = list(compare_training(sweeps))
    return [Part("training", TITLE, CHANGES, change_cells(claims, sweeps))] if claims else []


def runs_by_row(sweep: Sweep) -> RunsByRow:
    """Return the runs, by number of steps, of every row that has run with several."""
    found = {
        row: {steps: runs for steps, each in by_steps(sweep).items() if (runs := of_row(each, row))}
        for row in rows_of(sweep)
    }
    return {row: of_steps for row, of_steps in found.items() if len(of_steps) > 1}


def by_steps(sweep: Sweep) -> dict[str, Sweep]:
    """Return a sweep, and its longer ones that have a row in common with it, by their number of steps."""
    alike = [each for each in sweep.longer if any(of_row(each, row) for row in rows_of(sweep))]
    return {each.runs[0].setting[1]: each for each in (sweep, *alike)}


def rows_of(sweep: Sweep) -> list[str]:
    """Return the names of the rows of a sweep, and of those on other data with as many steps."""
    end = f"@{sweep.runs[0].setting[1]}"
    return list(dict.fromkeys([*sweep.rows, *(row.removesuffix(end) for row in sweep.lengths if row.endswith(end))]))


def of_row(sweep: Sweep, row: str) -> Sequence[FinishedRun]:
    """Return the runs of a row in a sweep; of a row on other data, those with as many steps."""
    return sweep.rows.get(row) or sweep.lengths.get(f"{row}@{sweep.runs[0].setting[1]}", ())


def decided_in(
    sweep: Sweep, tables: Sequence[PaperTable], claims: Sequence[Planned], judge: str
) -> list[Judged | None]:
    """Return how tables of a sweep decide claims in a metric, which may be those of a sweep with other steps."""
    decided, found = sweep.claims, {}
    for table in tables:
        for pair in pairs_of(table):
            name = name_of(*pair, sweep.table_rows, metric_of(table, judge))
            found.setdefault(_subject(table, *pair), decided[name] if name else None)
    return [found.get(_subject(*claim)) for claim in claims]


def _subject(table: PaperTable, better: PaperRow, other: PaperRow) -> tuple[str, ...]:
    """Return what a claim is about: both rows without steps and budget (`_budget` ends such names), and the metric."""
    return (*(row.run.partition("@")[0].removesuffix("_budget") for row in (better, other)), table.order_by)


def compare_training(sweeps: Mapping[str, Sweep]) -> Iterator[Compared]:
    """Yield the claims that were decided at two numbers of steps or more, each once."""
    for judge in JUDGES:
        claims = planned_claims(_once(next(iter(sweeps.values())).tables), judge)
        by_sweep = [decided_in(sweep, _once(sweep.tables), claims, judge) for sweep in sweeps.values()]
        for claim, *found in zip(claims, *by_sweep, strict=True):
            if sum(each is not None for each in found) > 1:
                yield Compared(title_of(*claim), judge, found)


def change_cells(claims: Sequence[Compared], sweeps: Mapping[str, Sweep]) -> Cells:
    """Return head and a line for each claim: gap and verdict at every number of steps, and how far the gap moved."""
    head = ["Claim", "Metric", *(title for each in sweeps for title in (f"{int(each):,} steps", "Verdict"))]
    head += ["Change", "No change: p", "Changes"]
    adjusted = adjusted_changes(claims, _once(next(iter(sweeps.values())).tables))
    lines = []
    for claim, p_value in zip(claims, adjusted, strict=True):
        cells = [
            cell
            for found in claim.found
            for cell in ((found.claim.gap.written, found.verdict) if found else ("–", "–"))
        ]
        changes = "unknown" if math.isnan(p_value) else "yes" if p_value < LEVEL else "not found"
        last = [claim.change.written, p_cell(claim.change.p_none, p_value), changes]
        lines.append([claim.title, claim.judge, *cells, *last])
    return head, lines


def adjusted_changes(claims: Sequence[Compared], tables: Sequence[PaperTable]) -> list[float]:
    """Return the p-value of 'the gap does not change' of each claim, adjusted by Holm.

    The family of a metric has the claims of all tables, as that of verdicts, whether their rows have run or not. Claims
    are in the order of metrics.
    """
    found: list[float] = []
    for judge in JUDGES:
        p_values = [claim.change.p_none for claim in claims if claim.judge == judge]
        found += holm(p_values, len(planned_claims(tables, judge)))
    return found


def training_csv(rows: RunsByRow, names: Mapping[str, str]) -> str:
    """Return CSV with a line for each row and number of steps: scores of the test, and those of validation on the way.

    The latter are means over seeds of the last validation up to each part of all steps.
    """
    head = ["row", "method", "steps", *(f"{judge}, {column}" for judge in JUDGES for column in SPREAD)]
    lines = []
    for row, of_steps in rows.items():
        for steps, runs in of_steps.items():
            scores = [cell for start in JUDGES.values() for cell in spread_cells(figure_of(runs, f"{start}rayiou"))]
            curves = [run.curves.get(VALIDATION, {}) for run in runs]
            ends = [_at(curves, float(steps) * part) for part in PARTS]
            lines.append([row, names.get(row, row), steps, *scores, *map(exact, ends)])
    return csv_text([*head, *(f"validation voxel RayIoU after {part:.0%} of the steps" for part in PARTS)], lines)


def _at(curves: Sequence[Mapping[int, float]], end: float) -> float | None:
    """Return the mean of the last values up to a step; None if a curve has none."""
    values = [[curve[step] for step in sorted(curve) if step <= end][-1:] for curve in curves]
    return statistics.fmean(value for (value,) in values) if all(values) else None


def _once(tables: Sequence[PaperTable]) -> list[PaperTable]:
    """Return the tables that have other runs for every number of steps."""
    return [table for table in tables if not table.of_lengths]
