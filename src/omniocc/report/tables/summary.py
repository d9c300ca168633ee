"""The lines that the report prints; everything is in its files."""

from collections import Counter
from collections.abc import Sequence

from omniocc.errors import shortened
from omniocc.report.sweep import Sweep
from omniocc.report.tables.claims import JUDGES
from omniocc.report.tables.names import method_names
from omniocc.report.tables.paper import figure_of, with_error
from omniocc.report.tables.verdicts import claim_lines
from omniocc.runs.table import VOXEL_RAYIOU, markdown

KEYS = {f"{start}rayiou": title for title, start in JUDGES.items()}
REMARKS, ROWS, WIDTH = 4, 10, 300
"""Most remarks and rows that are printed, and most characters of a remark."""


def first_lines(lines: Sequence[str], most: int, what: str) -> list[str]:
    """Return the first lines, and one that counts what is left out."""
    left = len(lines) - most
    return [*lines[:most], *[f"... and {left} more {what}"] * (left > 0)]


def summary(sweep: Sweep) -> str:
    """Return the remarks on a setting, its rows by falling RayIoU and the number of claims by verdict."""
    figures = [(row, runs, [figure_of(runs, key) for key in KEYS]) for row, runs in sweep.rows.items()]
    ranked = sorted(figures, key=lambda entry: -entry[2][0].mean if entry[2][0] else 0.0)
    names = method_names(sweep.tables)
    cells = [[row, names.get(row, "–"), str(len(runs)), *map(with_error, KEYS, found)] for row, runs, found in ranked]
    table = markdown(["row", "method", "seeds", *KEYS.values()], cells).splitlines()
    lines = claim_lines(sweep.tables, sweep.table_rows, sweep.claims)
    verdicts = Counter(line.verdict for line in lines if line.judge == VOXEL_RAYIOU)
    claims = f"Claims by {VOXEL_RAYIOU}: {', '.join(f'{verdict} {count}' for verdict, count in verdicts.items())}."
    remarks = first_lines([shortened(remark, WIDTH) for remark in sweep.remarks], REMARKS, "remarks")
    return "\n".join([*remarks, "", *first_lines(table, 2 + ROWS, "rows"), "", claims if verdicts else ""]).rstrip()
