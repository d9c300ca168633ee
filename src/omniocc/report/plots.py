"""Plots of a sweep: one colour per row, means over seeds with their standard error.

Every function takes the runs of each row, in the order in which rows are drawn, and returns None when there is nothing
to draw. matplotlib is the extra `plot`.
"""

import io
import math
import re
import statistics
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.figure import Figure as Canvas

from omniocc.io import atomic_write
from omniocc.report.runs import FRACTION, TRAINING, VALIDATION, FinishedRun, names_of
from omniocc.report.tables.paper import figure_of
from omniocc.report.tables.robustness import system_names
from omniocc.report.tables.training import RunsByRow
from omniocc.runs.robustness import Robustness, drop_of
from omniocc.runs.table import band_keys


class Curve(NamedTuple):
    """Mean, lowest and highest value over seeds, at each step recorded for all seeds."""

    steps: list[int]
    mean: list[float]
    low: list[float]
    high: list[float]


def over_seeds(curves: Sequence[dict[int, float]]) -> Curve:
    """Return the curves of several seeds as one."""
    steps = sorted(set.intersection(*(set(curve) for curve in curves))) if curves else []
    values = [[curve[step] for curve in curves] for step in steps]
    return Curve(steps, [statistics.fmean(v) for v in values], [min(v) for v in values], [max(v) for v in values])


def smoothed(curve: dict[int, float], window: int = 5) -> dict[int, float]:
    """Return the moving mean over `window` values, fewer at the ends."""
    steps, half = sorted(curve), window // 2
    return {
        step: statistics.fmean(curve[near] for near in steps[max(0, k - half) : k + half + 1])
        for k, step in enumerate(steps)
    }


Rows = Mapping[str, Sequence[FinishedRun]]

INK, LINE = "#1d2430", "#c9d0d9"
STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.edgecolor": LINE,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "svg.fonttype": "none",
    "svg.hashsalt": "omniocc",
}
WHISKER = {"ecolor": INK, "elinewidth": 1.0, "capsize": 2.0}


def without_math(rows: Mapping[str, Any]) -> dict[str, Any]:
    """Return rows with names in which matplotlib takes no `$` for the beginning of a formula."""
    return {row.replace("$", r"\$"): value for row, value in rows.items()}


def colors_of(rows: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Return a colour for each row; the first ten are easy to distinguish."""
    palette = [*colormaps["tab10"].colors, *colormaps["Dark2"].colors, *colormaps["Set2"].colors]  # type: ignore[attr-defined]
    return {row: palette[k % len(palette)] for k, row in enumerate(rows)}


@rc_context(STYLE)
def ranking(rows: Rows) -> Canvas | None:
    """Draw RayIoU of each row, best on top; a diamond is surface RayIoU, dots are single seeds."""
    figures = {row: figure for row, runs in rows.items() if (figure := figure_of(runs, "test/rayiou"))}
    if not figures:
        return None
    order = sorted(figures, key=lambda row: figures[row].mean)
    colors = colors_of(rows)
    canvas = Canvas(figsize=(5.2, 0.8 + 0.26 * len(order)), layout="constrained")
    axes = canvas.subplots()
    axes.barh(order, [figures[row].mean for row in order], color=[colors[row] for row in order], height=0.66)
    for place, row in enumerate(order):
        seeds = [run.metrics["test/rayiou"] for run in rows[row]]
        axes.plot(seeds, [place] * len(seeds), "o", color=INK, markersize=3.2)
        if lidar := figure_of(rows[row], "test/lidar/rayiou"):
            axes.plot([lidar.mean], [place], "D", markersize=4.5, color=INK, markerfacecolor="none")
        label = f"{figures[row].mean:.3f}"
        axes.annotate(label, (max(seeds), place), (6, 0), textcoords="offset points", va="center", fontsize=9)
    axes.grid(axis="y", visible=False)
    axes.set_xlim(0, 1.12 * max(figure.mean for figure in figures.values()))
    axes.set_xlabel("voxel RayIoU (dots: seeds; diamond: surface RayIoU)")
    axes.tick_params(axis="y", length=0)
    return canvas


def by_range(rows: Rows) -> Canvas | None:
    """Draw RayIoU of each row in each distance band."""
    every = [run for runs in rows.values() for run in runs]
    bands = band_keys(every[0].metrics) if every else []
    keys = {band.removeprefix("rayiou_").replace("m", " m"): f"test/{band}" for band in bands}
    return _bars(rows, [keys], 3.6, "distance of the true hit") if keys else None


def by_class(rows: Rows) -> Canvas | None:
    """Draw RayIoU of each row and class, in two panels."""
    keys = [(name, f"test/rayiou/{name}") for name in names_of([run for runs in rows.values() for run in runs])]
    half = (len(keys) + 1) // 2
    return _bars(rows, [dict(keys[:half]), dict(keys[half:])], 5.6, "class") if keys else None


@rc_context(STYLE)
def by_candidates(rows: Rows) -> Canvas | None:
    """Draw RayIoU against the fraction of voxels that are candidates."""
    points = {row: (figure_of(runs, FRACTION), figure_of(runs, "test/rayiou")) for row, runs in rows.items()}
    if not any(fraction and score for fraction, score in points.values()):
        return None
    colors = colors_of(rows)
    canvas = Canvas(figsize=(8.6, 3.8), layout="constrained")
    axes = canvas.subplots()
    for row, (fraction, score) in points.items():
        if fraction and score:
            xerr, yerr = (0.0 if math.isnan(figure.error) else figure.error for figure in (fraction, score))
            label = f"{row} ({100 * fraction.mean:.0f} %, {score.mean:.3f})"
            axes.errorbar(fraction.mean, score.mean, yerr, xerr, fmt="none", **WHISKER)
            axes.plot(fraction.mean, score.mean, "o", markersize=8, color=colors[row], label=label)
    axes.set_xlim(0, 1.05)
    axes.set_xlabel("candidates, fraction of all voxels")
    axes.set_ylabel("RayIoU")
    canvas.legend(loc="outside right upper", fontsize=9)
    return canvas


@rc_context(STYLE)
def training(rows: Rows) -> Canvas | None:
    """Draw validation RayIoU and training loss over the steps; the band spans the lowest to the highest seed."""
    colors = colors_of(rows)
    canvas = Canvas(figsize=(8.6, 3.6), layout="constrained")
    panels = canvas.subplots(1, 2)
    drawn = 0
    for axes, key in zip(panels, (VALIDATION, TRAINING), strict=True):
        for row, runs in rows.items():
            curves = [run.curves[key] for run in runs if key in run.curves]
            mean = over_seeds([smoothed(curve) for curve in curves] if key == TRAINING else curves)
            drawn += len(mean.steps)
            axes.plot(mean.steps, mean.mean, color=colors[row], marker=".", linewidth=1.6, label=row)
            if len(curves) > 1:
                axes.fill_between(mean.steps, mean.low, mean.high, color=colors[row], alpha=0.18, linewidth=0)
        axes.set_xlabel("optimizer step")
    panels[0].set_ylabel("RayIoU, validation")
    panels[1].set_ylabel("training loss, mean of five")
    _legend(canvas, panels[0], rows)
    return canvas if drawn else None


@rc_context(STYLE)
def learning_curves(rows: RunsByRow) -> Canvas | None:
    """Draw validation RayIoU of rows that have run with several numbers of steps; dashed: with fewer than the most."""
    colors = colors_of(rows)
    canvas = Canvas(figsize=(8.6, 4.2), layout="constrained")
    axes = canvas.subplots()
    drawn = 0
    for row, of_steps in rows.items():
        most = max(of_steps, key=float)
        for steps, runs in of_steps.items():
            mean = over_seeds([run.curves[VALIDATION] for run in runs if VALIDATION in run.curves])
            drawn += len(mean.steps)
            style, label = ("-", row) if steps == most else ("--", None)
            axes.plot(mean.steps, mean.mean, style, color=colors[row], marker=".", linewidth=1.6, label=label)
            axes.fill_between(mean.steps, mean.low, mean.high, color=colors[row], alpha=0.18, linewidth=0)
    axes.set_xscale("log")
    axes.set_xlabel("optimizer step")
    axes.set_ylabel("RayIoU, validation")
    canvas.legend(loc="outside right upper", title="band: lowest\nto highest seed", fontsize=9)
    return canvas if drawn else None


PLOTS = {
    "ranking": ("Every row", ranking),
    "range": ("By distance", by_range),
    "class": ("By class", by_class),
    "candidates": ("RayIoU against candidates", by_candidates),
    "training": ("Training curves", training),
}
"""Title and function of every plot, by the name of its file."""


@rc_context(STYLE)
def _bars(rows: Rows, panels: Sequence[Mapping[str, str]], height_inch: float, horizontal: str) -> Canvas:
    """Draw RayIoU of all rows in panels below one another, each with the keys of its metrics by their names."""
    canvas = Canvas(figsize=(8.6, height_inch), layout="constrained")
    drawn = canvas.subplots(len(panels), 1, squeeze=False)[:, 0]
    for axes, keys in zip(drawn, panels, strict=True):
        _grouped(axes, rows, keys)
        axes.set_ylabel("RayIoU")
    several = any(len(runs) > 1 for runs in rows.values())
    drawn[-1].set_xlabel(horizontal + " (whiskers: standard error over seeds)" * several)
    _legend(canvas, drawn[0], rows)
    return canvas


def _grouped(axes: Axes, rows: Rows, keys: Mapping[str, str]) -> None:
    colors, width = colors_of(rows), 0.84 / max(len(rows), 1)
    for k, (row, runs) in enumerate(rows.items()):
        places = [group - 0.42 + (k + 0.5) * width for group in range(len(keys))]
        figures = [figure_of(runs, key) for key in keys.values()]
        means = [figure.mean if figure else math.nan for figure in figures]
        whiskers = [figure.error if figure and not math.isnan(figure.error) else 0.0 for figure in figures]
        axes.bar(places, means, width * 0.92, color=colors[row], label=row)
        if any(whiskers):
            axes.errorbar(places, means, whiskers, fmt="none", **WHISKER)
    axes.set_xticks(range(len(keys)), list(keys))
    axes.set_ylim(bottom=0)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="x", visible=False)


def _legend(canvas: Canvas, axes: Axes, rows: Rows) -> None:
    handles, labels = axes.get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside upper left", ncols=min(5, max(len(rows), 1)), fontsize=9)


@rc_context(STYLE)
def drops(records: Sequence[Robustness]) -> Canvas:
    """Draw the drop of RayIoU by disturbance, a bar for each system; whiskers are standard errors over scenes."""
    names = list(dict.fromkeys(part.part for record in records for part in record.disturbed))
    height = 0.84 / len(records)
    canvas = Canvas(figsize=(8.6, 1.0 + max(0.2, 0.13 * len(records)) * len(names)), layout="constrained")
    axes = canvas.subplots()
    for number, (record, label) in enumerate(zip(records, system_names(records), strict=True)):
        found = {part.part: drop_of(part, record.undisturbed) for part in record.disturbed}
        places = [names.index(name) - 0.42 + (number + 0.5) * height for name in found]
        errors = [0.0 if math.isnan(drop.error) else drop.error for drop in found.values()]
        color = colormaps["tab10"].colors[number % 10]  # type: ignore[attr-defined]
        values = [drop.value for drop in found.values()]
        axes.barh(places, values, height * 0.92, color=color, label=label)
        axes.errorbar(values, places, xerr=errors, fmt="none", **WHISKER)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0, labelsize=8)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("drop of RayIoU (whiskers: standard error over scenes)")
    canvas.legend(loc="outside upper left", ncols=4, fontsize=9)
    return canvas


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


def as_svg(figure: Figure, name: str, title: str) -> tuple[str, str]:
    """Return the SVG file of a figure on white, and the same as an `<svg>` element of a page; it is drawn once.

    Args:
        figure: a figure with text in `INK` and lines in `LINE`.
        name: prefix of every id, so that several figures can be in one page.
        title: description for screen readers.
    """
    buffer = io.StringIO()
    with rc_context(STYLE):
        if (layout := figure.get_layout_engine()) is not None:
            layout.execute(figure)  # `savefig` would draw the whole figure once more for it
            figure.set_layout_engine("none")
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    file = buffer.getvalue()
    svg = file[file.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg).replace("xlink:href", "href")
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r"(url\(|href=\")#", rf"\1#{name}-", svg)
    svg = re.sub(r"<style.*?</style>|font-family:[^;\"]*;? ?", "", svg, flags=re.DOTALL)
    svg = svg.replace(INK, "currentColor").replace(LINE, "var(--line)")
    width_px = figure.get_figwidth() * 96
    size = f"min-width: {SMALLEST * width_px:.0f}px; max-width: {LARGEST * width_px:.0f}px"
    head = f'<svg role="img" aria-label="{escape(title)}" style="{size}" viewBox'
    on_white = file.replace("<svg ", '<svg style="background-color: white" ', 1)
    return on_white, re.sub(r"<svg[^>]*?viewBox", lambda _: head, svg, count=1)
