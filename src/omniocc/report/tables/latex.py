"""Tables in LaTeX."""

from collections.abc import Sequence


def tabular(comment: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a tabular below a comment; the first column is text, the others are centred. Cells are LaTeX."""
    lines = [f"% {comment}", rf"\begin{{tabular}}{{l{'c' * (len(head) - 1)}}}", r"\toprule"]
    lines += [" & ".join(head) + r" \\", r"\midrule", *(" & ".join(row) + r" \\" for row in rows)]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])
