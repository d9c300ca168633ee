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
    planned,
    streets_cell,
)
from omniocc.report.tables.paper import PaperRow, PaperTable
from omniocc.run.table import markdown

TITLE = "All claims"
NOTE = (
    "Every claim of every table once, by the verdict of the paper's own metric, own voxels: here ± standard error over "
    "seeds, ± over streets. 'In proportion' is the paper's gap where scores are as here. Seeds: of both rows."
)
NOT_RUN = "not run"
ORDER = (HOLDS, AGAINST, UNDECIDED, NOT_RUN)


def verdicts_chapter(tables: Sequence[PaperTable], rows: Rows, decided: Mapping[Name, Judged]) -> str:
    """Return the page as Markdown; empty if no table has a claim."""
    claims = planned(tables, "own voxels")
    lines = sorted((_line(*claim, rows, decided) for claim in claims), key=lambda line: _place(line[5]))
    if not lines:
        return ""
    head = ["claim", "table", "paper", "in proportion", "seeds", "verdict", *JUDGES, "verdict by LiDAR rays"]
    return f"## {TITLE}\n\n{NOTE}\n\n{markdown(head, lines)}"


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
    title = better.ahead_of(other)
    if own is None:
        gap = (better.paper[table.order_by] or 0.0) - (other.paper[table.order_by] or 0.0)
        return [title, table.title, f"{gap:+.3f}", "–", "–", NOT_RUN, *"–" * len(JUDGES), "–"]
    seeds = " and ".join(str(len(rows[row.run])) for row in (better, other))
    gaps = [
        "–" if each is None else f"{each.claim.gap.written} {streets_cell(each.claim)}".removesuffix(" –")
        for each in found.values()
    ]
    sizes = f"{own.claim.paper:+.3f}", f"{own.claim.size:+.3f}"
    return [title, table.title, *sizes, seeds, own.verdict, *gaps, "–" if lidar is None else lidar.verdict]
