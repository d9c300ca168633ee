"""All claims of all tables in one list, by verdict."""

from collections.abc import Mapping, Sequence

from omniocc.report.tables.claims import (
    AGAINST,
    HOLDS,
    JUDGES,
    UNDECIDED,
    Judged,
    Name,
    Rows,
    metric_of,
    name_of,
    planned_claims,
    streets_cell,
    title_of,
)
from omniocc.report.tables.paper import PaperRow, PaperTable
from omniocc.run.table import Cells, markdown

TITLE = "All claims"
NOTE = (
    "Every claim of every table once, in the order of its verdict by the paper's own metric, own voxels. 'In "
    "proportion': the printed gap / the printed score of the better method x its score here. 'Seeds': how many the "
    "first and the second row have. A gap has its standard error over seeds, then over streets, which is not known for "
    "bands of distance."
)
NOT_RUN = "not run"
ORDER = (HOLDS, AGAINST, UNDECIDED, NOT_RUN)


def verdicts_chapter(tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged]) -> str:
    """Return the page as Markdown; empty if no table has a claim."""
    head, lines = verdict_cells(tables, rows, decided)
    return f"## {TITLE}\n\n{NOTE}\n\n{markdown(head, lines)}" if lines else ""


def verdict_cells(tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged]) -> Cells:
    """Return head and a line for each claim of all tables, by verdict."""
    claims = planned_claims(tables, "own voxels")
    lines = sorted((_line(*claim, rows, decided) for claim in claims), key=lambda line: _place(line[5]))
    return ["claim", "table", "paper", "in proportion", "seeds", "verdict", *JUDGES, "verdict by LiDAR rays"], lines


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
        return [
            title,
            table.title,
            f"{table.printed_gap(better, other):+.3f}",
            "–",
            "–",
            NOT_RUN,
            *"–" * len(JUDGES),
            "–",
        ]
    seeds = " and ".join(str(len(rows[row.run])) for row in (better, other))
    gaps = [
        "–" if each is None else f"{each.claim.gap.written} {streets_cell(each.claim)}".removesuffix(" –")
        for each in found.values()
    ]
    sizes = f"{own.claim.paper:+.3f}", f"{own.claim.size:+.3f}"
    return [title, table.title, *sizes, seeds, own.verdict, *gaps, "–" if lidar is None else lidar.verdict]
