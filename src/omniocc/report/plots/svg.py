"""matplotlib's figures as PNG, and as SVG: in a file, or in a page with its fonts, light and dark colours, own ids."""

import io
import re
from html import escape
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from omniocc.io import atomic_write
from omniocc.report.plots.figures import INK, LINE, STYLE

SMALLEST, LARGEST = 0.65, 1.5
"""Scales between which a page may resize a plot; on narrower pages it scrolls."""


def save_svg(figure: Figure, path: Path) -> None:
    """Write a figure on white to a file, the same bytes for the same figure."""
    buffer = io.BytesIO()
    with rc_context(STYLE):
        figure.savefig(buffer, format="svg", facecolor="white", metadata={"Date": None, "Creator": None})
    atomic_write(path, buffer.getvalue())


def as_png(figure: Figure) -> bytes:
    """Return the PNG file of a figure on white."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, facecolor="white")
    return buffer.getvalue()


def as_svg(figure: Figure, name: str, title: str) -> str:
    """Return a figure as an `<svg>` element.

    Args:
        figure: a figure with text in `INK` and lines in `LINE`.
        name: prefix of every id, so that several figures can be in one page.
        title: description for screen readers.
    """
    buffer = io.StringIO()
    with rc_context(STYLE):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg).replace("xlink:href", "href")
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r"(url\(|href=\")#", rf"\1#{name}-", svg)
    svg = re.sub(r"<style.*?</style>|font-family:[^;\"]*;? ?", "", svg, flags=re.DOTALL)
    svg = svg.replace(INK, "currentColor").replace(LINE, "var(--line)")
    width_px = figure.get_figwidth() * 96
    size = f"min-width: {SMALLEST * width_px:.0f}px; max-width: {LARGEST * width_px:.0f}px"
    head = f'<svg role="img" aria-label="{escape(title)}" style="{size}" viewBox'
    return re.sub(r"<svg[^>]*?viewBox", lambda _: head, svg, count=1)
