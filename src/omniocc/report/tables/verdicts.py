"""All claims of all tables: by verdict for each metric, again by paired differences, and as CSV."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from omniocc.report.tables.claims import (
    AGAINST,
    HOLDS,
    JUDGES,
    UNDECIDED,
    Judged,
    Name,
    Rows,
    gap_by_seed,
    metric_of,
    name_of,
    p_cell,
    planned_claims,
    signed,
    title_of,
    verdicts_of,
)
from omniocc.report.tables.formats import Part, exact
from omniocc.report.tables.paper import PaperRow, PaperTable
from omniocc.runs.table import Cells, number

TITLE = "Claims by {}"
NOTE = (
    "Every claim of every table once, by its verdict. Rescaled: the printed gap / the printed score of the better "
    "method x its score here. Gap: with its standard error over seeds. Error over scenes: the standard error of the "
    "gap over the scenes of the test (jackknife), which is not known for bands of distance. Seeds: how many the first "
    "and the second method have. p: of 'there is no gap' and of 'the gap is as large as the paper's', in brackets "
    "adjusted for the number of claims (Holm)."
)
PAIRED_TITLE = "Claims by paired differences"
PAIRED_NOTE = (
    "Claims about methods that use the same depth network in a seed, tested once more by the difference of both "
    "scores in each such seed (paired t-test, Holm's correction over the same family). This assumes neither that the "
    "differences of all pairs vary alike, nor that two grids are independent of each other. The verdict of the tables "
    "above decides. It stands beside the paired one, which finds fewer gaps: a pair leaves {freedom} of freedom."
)
NOT_RUN, OTHERWISE = "not run", "not compared: other protocols"
ORDER = (HOLDS, AGAINST, UNDECIDED, OTHERWISE, NOT_RUN)


class ClaimLine(NamedTuple):
    """A claim in one metric; `found` is None where it was not decided, `paired` where no seeds can be paired."""

    table: PaperTable
    better: PaperRow
    other: PaperRow
    judge: str
    seeds: tuple[int, int]
    found: Judged | None
    paired: Judged | None

    @property
    def title(self) -> str:
        """Return the claim in words."""
        return title_of(self.table, self.better, self.other)

    @property
    def verdict(self) -> str:
        """Return the verdict, or why there is none."""
        if self.found is not None:
            return self.found.verdict
        return OTHERWISE if all(self.seeds) else NOT_RUN

    @property
    def cells(self) -> list[str]:
        """Return the cells of a line of its metric's table."""
        first = [self.title, self.table.short, self.verdict]
        printed = signed(self.table.printed_gap(self.better, self.other))
        if self.found is None:
            return [*first, "–", printed, *["–"] * 5]
        claim, none, size = self.found
        gaps = [claim.gap.written, printed, signed(claim.size), number(claim.streets)]
        tests = p_cell(claim.gap.p_none, none), p_cell(claim.p_size, size)
        return [*first, *gaps, " and ".join(map(str, self.seeds)), *tests]


HEAD = ["Claim", "Table", "Verdict", "Gap here", "Paper", "Rescaled", "Error over scenes", "Seeds", "No gap: p"]
HEAD += ["Paper's gap: p"]
"""Titles of `ClaimLine.cells`."""


def claim_lines(tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged]) -> list[ClaimLine]:
    """Return every claim of all tables in each metric, by verdict."""
    paired, lines = verdicts_of(tables, rows, paired=True), []
    for judge in JUDGES:
        for table, better, other in planned_claims(tables, judge):
            key = metric_of(table, judge)
            name = name_of(better, other, rows, key)
            seeds = len(rows.get(better.run, ())), len(rows.get(other.run, ()))
            by_seed = name and not math.isnan(gap_by_seed(table, better, other, rows, name[-1]).here)
            found, pairs = decided[name] if name else None, paired[name] if name and by_seed else None
            lines.append(ClaimLine(table, better, other, judge, seeds, found=found, paired=pairs))
    return sorted(lines, key=lambda line: next(k for k, start in enumerate(ORDER) if line.verdict.startswith(start)))


def verdicts_parts(tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged]) -> list[Part]:
    """Return a table of claims for each metric, and one of those that can be paired."""
    lines = claim_lines(tables, rows, decided)
    parts = [
        Part(f"claims-{judge.split()[0]}", TITLE.format(judge), NOTE, (HEAD, [each.cells for each in of_judge]))
        for judge in JUDGES
        if (of_judge := [line for line in lines if line.judge == judge])
    ]
    paired = [(line, line.paired) for line in lines if line.paired]
    if paired:
        freedom = sorted({int(found.claim.gap.freedom) for _, found in paired})
        ends = " to ".join(map(str, dict.fromkeys((freedom[0], freedom[-1]))))
        note = PAIRED_NOTE.format(freedom=f"{ends} degree{'s' * (ends != '1')}")
        parts.append(Part("claims-paired", PAIRED_TITLE, note, paired_cells(paired)))
    return parts


def paired_cells(lines: Sequence[tuple[ClaimLine, Judged]]) -> Cells:
    """Return head and a line for each claim and metric by paired differences, beside the verdict that decides."""
    head = ["Claim", "Table", "Metric", "Verdict", "Paired verdict", "Gap here", "No gap: p", "Seeds in common"]
    return head, [
        [
            line.title,
            line.table.short,
            line.judge,
            line.verdict,
            found.verdict,
            found.claim.gap.written,
            p_cell(found.claim.gap.p_none, found.none),
            f"{found.claim.gap.freedom + 1:.0f}",
        ]
        for line, found in lines
    ]


CSV_HEAD = ["steps", "metric", "table", "claim", "seeds of the first method", "seeds of the second method", "verdict"]
CSV_HEAD += ["paper's gap", "paper's gap rescaled", "gap here", "standard error over seeds", "degrees of freedom"]
CSV_HEAD += ["standard error over scenes", "p of no gap", "p of no gap adjusted", "p of the paper's gap"]
CSV_HEAD += ["p of the paper's gap adjusted", "paired gap", "paired standard error", "seeds in common"]
CSV_HEAD += ["paired p of no gap", "paired p of no gap adjusted", "paired verdict"]


def csv_lines(
    tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged], steps: str
) -> Iterator[list[str]]:
    """Yield the lines below `CSV_HEAD` of all claims that were decided."""
    for line in claim_lines(tables, rows, decided):
        if line.found is not None:
            claim, paired = line.found.claim, line.paired
            values = [claim.paper, claim.size, *claim.gap, claim.streets]
            values += [claim.gap.p_none, line.found.none, claim.p_size, line.found.size]
            cells = [steps, line.judge, line.table.short, line.title, *map(str, line.seeds), line.verdict]
            again = [""] * 6
            if paired is not None:
                gap = paired.claim.gap
                again = [*map(exact, (*gap[:2], gap.freedom + 1, gap.p_none, paired.none)), paired.verdict]
            yield [*cells, *map(exact, values), *again]
