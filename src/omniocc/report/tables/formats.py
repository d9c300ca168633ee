"""Tables as LaTeX, as CSV and as parts of a page."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from omniocc.runs.table import Cells, markdown


def tabular(comment: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a tabular below a comment; the first column is text, the others are centred. Cells are LaTeX."""
    lines = [f"% {comment}", rf"\begin{{tabular}}{{l{'c' * (len(head) - 1)}}}", r"\toprule"]
    lines += [" & ".join(head) + r" \\", r"\midrule", *(" & ".join(row) + r" \\" for row in rows)]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def csv_text(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return CSV with a line for the head and one for each row."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([head, *rows])
    return out.getvalue()


def exact(value: float | None) -> str:
    """Return a figure for CSV, with six digits that count; nothing for what is not known."""
    return "" if value is None or math.isnan(value) else f"{value:.6g}"


class Part(NamedTuple):
    """A table of a page, with the name of its place and a remark."""

    name: str
    title: str
    note: str
    cells: Cells


def parts_text(parts: Sequence[Part]) -> str:
    """Return tables as Markdown, each below a heading of level 2, its remark under it."""
    texts = [text.strip() for part in parts for text in (f"## {part.title}", markdown(*part.cells), part.note)]
    return "\n\n".join(filter(None, texts))
