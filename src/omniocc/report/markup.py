"""Small pieces of HTML; every text that comes from outside goes through `text`."""

import os
from collections.abc import Sequence
from html import escape as text
from pathlib import Path
from urllib.parse import quote


def table(head: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    """A table in a box of its own that scrolls where it is too wide.

    Args:
        head: cells, HTML.
        rows: cells of each line, HTML or what `cell` makes.
        kind: class of the table.
    """
    top = "".join(f"<th>{title}</th>" for title in head)
    lines = (("".join(part if part.startswith("<td") else f"<td>{part}</td>" for part in row)) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return (
        f'<div class="scroll" tabindex="0"><table class="{kind}"><thead><tr>{top}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def cell(content: str, kind: str, lines: int = 1) -> str:
    """A cell of a class, over several lines."""
    return f'<td class="{kind}" rowspan="{lines}">{content}</td>'


def plain_table(head: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    """A table of texts."""
    return table([*map(text, head)], [[*map(text, row)] for row in rows], kind)


def card(name: str, title: str, *parts: str) -> str:
    """A section with a heading; `name` is where links go."""
    return f'<section class="card" id="{name}"><h2>{text(title)}</h2>{"".join(parts)}</section>'


def link(target: str, label: str) -> str:
    """To a place in this page or a file beside it; the label is a text."""
    return f'<a href="{text(target)}">{text(label)}</a>'


def path_between(start: Path, target: Path) -> str:
    """How a page in the folder `start` calls a file or folder."""
    return quote(os.path.relpath(target.resolve(), start.resolve()))


def note(line: str) -> str:
    """A paragraph of a text; nothing for none."""
    return f'<p class="note">{text(line)}</p>' if line else ""


def picture(address: str, alt: str, caption: str = "") -> str:
    """A picture with a caption below."""
    below = f"<figcaption>{text(caption)}</figcaption>" if caption else ""
    return f'<figure><img src="{address}" alt="{text(alt)}" loading="lazy">{below}</figure>'


def swatch(rgb: Sequence[float], label: str) -> str:
    """A coloured square with a name."""
    color = "#" + "".join(f"{round(part):02x}" for part in rgb)
    return f'<span class="key"><i style="background:{color}"></i>{text(label)}</span>'
