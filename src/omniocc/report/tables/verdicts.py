"""All claims of all tables in one list, by verdict."""

import math
from collections.abc import Mapping, Sequence

from omniocc.report.tables.claims import (
    AGAINST,
    HOLDS,
    JUDGES,
    UNDECIDED,
    Judged,
    Name,
    Rows,
    both_errors,
    gap_by_seed,
    judged,
    metric_of,
    name_of,
    p_cell,
    planned_claims,
    signed,
    title_of,
)
from omniocc.report.tables.formats import Part
from omniocc.report.tables.paper import PaperRow, PaperTable
from omniocc.run.table import Cells

TITLE = "All claims"
NOTE = (
    "Every claim of every table once, in the order of its verdict by the paper's own metric, own voxels. 'In "
    "proportion': the printed gap / the printed score of the better method x its score here. 'Seeds': how many the "
    "first and the second row have. A gap has its standard error over seeds, then over streets, which is not known for "
    "bands of distance."
)
PAIRED_TITLE = "The same by paired differences"
PAIRED_NOTE = (
    "The claims about rows that use the same depth network in a seed once more, tested by the difference of both "
    "scores in each such seed and the standard deviation of these differences alone (paired t-test), with Holm's "
    "correction over the same family. This assumes neither that the differences of all pairs of rows vary alike, nor "
    "that two grids are independent of each other. The rule is that of the table above: a single pair leaves {freedom} "
    "of freedom, with which fewer gaps are found. Where the verdicts differ, that above depends on its assumption."
)
IN_COMMON = "seeds in common"
NOT_RUN, OTHERWISE = "not run", "not compared: other protocols"
ORDER = (HOLDS, AGAINST, UNDECIDED, OTHERWISE, NOT_RUN)


def verdicts_parts(tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged]) -> list[Part]:
    """Return the tables of the page, of which the second needs rows that share the depth network."""
    head, paired = paired_cells(tables, rows, decided)
    freedom = sorted({int(line[head.index(IN_COMMON)]) - 1 for line in paired})
    ends = " to ".join(map(str, dict.fromkeys((freedom[0], freedom[-1])))) if freedom else ""
    about = PAIRED_NOTE.format(freedom=f"{ends} degree{'s' * (ends != '1')}")
    parts = [
        Part("claims", TITLE, NOTE, verdict_cells(tables, rows, decided)),
        Part("claims-paired", PAIRED_TITLE, about, (head, paired)),
    ]
    return [part for part in parts if part.cells[1]]


def verdict_cells(tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged]) -> Cells:
    """Return head and a line for each claim of all tables, by verdict."""
    claims = planned_claims(tables, "own voxels")
    lines = sorted((_line(*claim, rows, decided) for claim in claims), key=lambda line: _place(line[5]))
    return ["claim", "table", "paper", "in proportion", "seeds", "verdict", *JUDGES, "verdict by LiDAR rays"], lines


def paired_cells(tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged]) -> Cells:
    """Return head and a line for each claim and judge by paired differences, beside the verdict of `decided`."""
    head = ["claim", "table", "judge", IN_COMMON, "gap ± error", "no gap: p (Holm)", "paired verdict"]
    head += ["verdict above", "differs"]
    paired, lines = judged(tables, rows, paired=True), []
    for table, better, other in planned_claims(tables, "own voxels"):
        for judge in JUDGES:
            name = name_of(better, other, rows, metric_of(table, judge))
            if name is None or math.isnan(gap_by_seed(table, better, other, rows, name[-1]).here):
                continue
            alone, above = paired[name], decided[name]
            cells = [title_of(table, better, other), table.title, judge, f"{alone.claim.gap.freedom + 1}"]
            differs = "yes" if alone.verdict != above.verdict else "no"
            p_values = p_cell(alone.claim.gap.p_none, alone.none)
            lines.append([*cells, alone.claim.gap.written, p_values, alone.verdict, above.verdict, differs])
    return head, lines


def _place(verdict: str) -> int:
    return next(place for place, start in enumerate(ORDER) if verdict.startswith(start))


def _line(
    table: PaperTable, better: PaperRow, other: PaperRow, rows: Rows, decided: Mapping[Name, Judged]
) -> list[str]:
    found = {}
    for judge in JUDGES:
        name = name_of(better, other, rows, metric_of(table, judge))
        found[judge] = None if name is None else decided[name]
    own, lidar = found.values()
    title = title_of(table, better, other)
    if own is None:
        printed = signed(table.printed_gap(better, other))
        ran = better.run in rows and other.run in rows
        return [title, table.title, printed, "–", "–", OTHERWISE if ran else NOT_RUN, *["–"] * len(JUDGES), "–"]
    seeds = " and ".join(str(len(rows[row.run])) for row in (better, other))
    gaps = ["–" if each is None else both_errors(each.claim) for each in found.values()]
    sizes = signed(own.claim.paper), signed(own.claim.size)
    return [title, table.title, *sizes, seeds, own.verdict, *gaps, "–" if lidar is None else lidar.verdict]
