"""The same claims after more steps, side by side, and the learning curves."""

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import Sweep
from omniocc.report.tables.claims import (
    JUDGES,
    LEVEL,
    Judged,
    Name,
    metric_of,
    name_of,
    p_cell,
    pairs_of,
    planned_claims,
    signed,
    title_of,
)
from omniocc.report.tables.formats import Part, parts_text
from omniocc.report.tables.gaps import Gap, change
from omniocc.report.tables.holm import holm
from omniocc.report.tables.paper import PaperTable, figure_of, with_spread
from omniocc.run.curves import read_curve
from omniocc.run.table import Cells, number

TITLE = "The same rows and claims after more steps"
NOTE = "Rows that have run with several numbers of steps of the last stage."
CHANGES = (
    "Claims whose two rows have both run with several numbers of steps. Each number of steps is a family of its own "
    "for Holm's correction. A verdict can also differ because one number of steps has more seeds. Therefore the "
    "change of the gap, from the fewest to the most steps, is tested itself: as if the runs of both had no noise in "
    "common, with Holm's correction over as many claims as a family has. Where scores rise with training, gaps "
    "rise with them: a change is not yet one in proportion."
)
CURVES_TITLE = "Learning curves"
CURVES = (
    "RayIoU on validation scenes on the way, mean over seeds, at the last validation up to each part of the steps. "
    "The learning rate falls to the end of all steps, so that the beginning of a long run is not a short run."
)
RunsByRow = Mapping[str, Mapping[str, Sequence[FinishedRun]]]
"""Runs by row and number of steps."""
PARTS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Parts of all steps after which a training is validated by default."""


class Compared(NamedTuple):
    """A claim in the settings in which it was decided, by steps."""

    title: str
    judge: str
    found: Mapping[str, Judged]

    @property
    def change(self) -> Gap:
        """Return how far the gap moves from the fewest to the most steps."""
        first, *_, last = self.found.values()
        return change(first.claim.gap, last.claim.gap)


def chapter(sweep: Sweep) -> str:
    """Return the page as Markdown; empty without a row that has run with several numbers of steps."""
    return parts_text(parts_of(sweep))


def parts_of(sweep: Sweep) -> list[Part]:
    """Return the tables of scores, claims and learning curves of a sweep and of its `longer` ones."""
    sweeps, rows = by_steps(sweep), runs_by_row(sweep)
    if not rows:
        return []
    parts = [Part("training", TITLE, NOTE, score_cells(list(sweeps), rows))]
    if claims := list(compared(sweeps)):
        parts.append(Part("training-claims", "What changes with training", CHANGES, change_cells(claims, sweeps)))
    return [*parts, Part("learning-curves", CURVES_TITLE, CURVES, curve_cells(rows))]


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


def score_cells(numbers: Sequence[str], rows: RunsByRow) -> Cells:
    """Return head and a line for each row: RayIoU by both judges at every number of steps."""
    head = ["row", *(f"{title}, {steps} steps" for title in ("RayIoU", "LiDAR") for steps in numbers)]
    keys = [(key, steps) for key in ("test/rayiou", "test/lidar/rayiou") for steps in numbers]
    lines = [
        [row, *(with_spread(key, figure_of(runs.get(steps, ()), key)) for key, steps in keys)]
        for row, runs in rows.items()
    ]
    return head, lines


def compared(sweeps: Mapping[str, Sweep]) -> Iterator[Compared]:
    """Yield the claims that were decided at two numbers of steps or more, each once."""
    decided = {steps: sweep.claims for steps, sweep in sweeps.items()}
    tables = [{table.name: table for table in sweep.tables} for sweep in sweeps.values()]
    seen = set()
    for table in _once(next(iter(sweeps.values())).tables):
        for pairs in zip(*(pairs_of(of_steps[table.name]) for of_steps in tables), strict=True):
            better, other = pairs[0]
            for judge in JUDGES:
                names: dict[str, Name | None] = {
                    steps: name_of(ahead, behind, sweep.table_rows, metric_of(table, judge))
                    for (steps, sweep), (ahead, behind) in zip(sweeps.items(), pairs, strict=True)
                }
                found = {steps: decided[steps][name] for steps, name in names.items() if name}
                known = tuple(names.values())
                if len(found) > 1 and known not in seen:
                    seen.add(known)
                    yield Compared(title_of(table, better, other), judge, found)


def change_cells(claims: Sequence[Compared], sweeps: Mapping[str, Sweep]) -> Cells:
    """Return head and a line for each claim: gap and verdict at every number of steps, and how far the gap moved."""
    head = ["claim", "paper", "judge", *(title for each in sweeps for title in (f"at {each} steps", "verdict"))]
    head += ["change", "no change: p (Holm)", "changes"]
    adjusted = adjusted_changes(claims, _once(next(iter(sweeps.values())).tables))
    lines = []
    for claim, p_value in zip(claims, adjusted, strict=True):
        cells = [
            cell
            for each in sweeps
            for cell in (
                (claim.found[each].claim.gap.written, claim.found[each].verdict) if each in claim.found else ("–", "–")
            )
        ]
        paper = next(iter(claim.found.values())).claim.paper
        changes = "unknown" if math.isnan(p_value) else "yes" if p_value < LEVEL else "not found"
        last = [claim.change.written, p_cell(claim.change.p_none, p_value), changes]
        lines.append([claim.title, signed(paper), claim.judge, *cells, *last])
    return head, lines


def adjusted_changes(claims: Sequence[Compared], tables: Sequence[PaperTable]) -> list[float]:
    """Return the p-value of 'the gap does not change' of each claim, adjusted by Holm.

    The family of a judge has the claims of all tables, as that of verdicts, whether their rows have run or not.
    """
    found = [math.nan] * len(claims)
    for judge in JUDGES:
        places = [
            place for place, claim in enumerate(claims) if claim.judge == judge and not math.isnan(claim.change.error)
        ]
        p_values = holm([claims[place].change.p_none for place in places], len(planned_claims(tables, judge)))
        for place, p_value in zip(places, p_values, strict=True):
            found[place] = p_value
    return found


def curve_cells(rows: RunsByRow) -> Cells:
    """Return head and a line for each row and number of steps: RayIoU on validation scenes after parts of the steps."""
    lines = []
    for row, of_steps in rows.items():
        for steps, runs in of_steps.items():
            ends = [float(steps) * part for part in PARTS]
            curves = [read_curve(run.folder, "val/rayiou") for run in runs]
            lines.append([row, steps, *(number(_at(curves, end)) for end in ends)])
    return ["row", "steps", *(f"{part:.0%}" for part in PARTS)], lines


def _at(curves: Sequence[Mapping[int, float]], end: float) -> float | None:
    """Return the mean of the last values up to a step; None if a curve has none."""
    values = [[curve[step] for step in sorted(curve) if step <= end][-1:] for curve in curves]
    return statistics.mean(value for (value,) in values) if all(values) else None


def _once(tables: Sequence[PaperTable]) -> list[PaperTable]:
    """Return the tables that have other runs for every number of steps."""
    return [table for table in tables if not table.of_lengths]
