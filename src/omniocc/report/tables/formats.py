"""Tables as LaTeX, as CSV and as parts of a page."""

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from omniocc.run.table import Cells, markdown


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


class Part(NamedTuple):
    """A table of a page, with the name of its place and a remark above it."""

    name: str
    title: str
    note: str
    cells: Cells


def parts_text(parts: Sequence[Part]) -> str:
    """Return tables as Markdown, the first below a heading of level 2, the others of level 3."""
    heads = [f"{'###' if number else '##'} {part.title}" for number, part in enumerate(parts)]
    texts = [text for head, part in zip(heads, parts, strict=True) for text in (head, part.note, markdown(*part.cells))]
    return "\n\n".join(text.rstrip() for text in texts) + "\n" * bool(texts)
