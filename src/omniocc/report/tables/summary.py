"""The lines that the report prints; everything is in its files."""

from collections import Counter
from collections.abc import Sequence

from omniocc.errors import shortened
from omniocc.report.sweep import Sweep
from omniocc.report.tables.paper import figure_of, with_spread
from omniocc.report.tables.verdicts import verdict_cells
from omniocc.run.table import SCORES, markdown

KEYS = {f"test/{kind}": SCORES[kind] for kind in ("rayiou", "lidar/rayiou")}
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
    cells = [[row, str(len(runs)), *map(with_spread, KEYS, found)] for row, runs, found in ranked]
    table = markdown(["row", "seeds", *KEYS.values()], cells).splitlines()
    verdicts = Counter(line[5] for line in verdict_cells(sweep.tables, sweep.table_rows, sweep.claims)[1])
    claims = f"Claims by own voxels: {', '.join(f'{verdict} {count}' for verdict, count in verdicts.items())}."
    remarks = first_lines([shortened(remark, WIDTH) for remark in sweep.remarks], REMARKS, "remarks")
    return "\n".join([*remarks, "", *first_lines(table, 2 + ROWS, "rows"), "", claims if verdicts else ""]).rstrip()
