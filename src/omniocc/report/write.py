"""Write the report over all runs: tables, plots and pages."""

import importlib.util
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, urlencode

import cv2
import numpy as np
from markupsafe import Markup

from omniocc.draw import SheetParts
from omniocc.draw.bev import ERRORS
from omniocc.draw.canvas import fitted
from omniocc.errors import shortened
from omniocc.io import atomic_write
from omniocc.progress import Progress
from omniocc.report.chapters import SPREAD, parts_with_runs, report_markdown, write_tables
from omniocc.report.docs import NO_MATPLOTLIB
from omniocc.report.html import render, webp
from omniocc.report.runs import FinishedRun, colors_of, grid_kind, grid_of, path_between
from omniocc.report.sweep import Sweep
from omniocc.report.tables import robustness as disturbed
from omniocc.report.tables import training
from omniocc.report.tables.claims import JUDGES
from omniocc.report.tables.names import method_names
from omniocc.report.tables.paper import figure_of, with_error
from omniocc.report.tables.verdicts import claim_lines
from omniocc.runs.folder import PAGE, PARTS
from omniocc.runs.results import IMAGES, MINUTES
from omniocc.runs.table import VOXEL_RAYIOU, markdown

FRAME_NAME = re.compile(r"test-(\d+)-(.+)-(\d+)")
WEBP_QUALITY = 78


class Shown(NamedTuple):
    """One row's prediction of a frame.

    Attributes:
        row: name of the row.
        run: its first seed.
        parts: images of the sheet.
        grid: kind of the row's grid, empty if an earlier row has the same grid.
    """

    row: str
    run: FinishedRun
    parts: SheetParts
    grid: str


class ComparedFrame(NamedTuple):
    """A test frame and every row's prediction of it."""

    scene: str
    frame: str
    shown: Sequence[Shown]


def compared_frames(rows: Mapping[str, Sequence[FinishedRun]]) -> list[ComparedFrame]:
    """Return all frames with sheets, as the first seed of each row predicts them.

    Runs that saved no parts of their sheets are left out with a message.
    """
    frames: dict[tuple[str, str, str], list[Shown]] = {}
    grids: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row, runs in rows.items():
        geometry = grid_of(runs[0].config)
        for key, parts in _parts(runs[0].folder / IMAGES):
            new = geometry not in grids.setdefault(key, [])
            grids[key].append(geometry)
            frames.setdefault(key, []).append(Shown(row, runs[0], parts, grid_kind(runs[0].config) if new else ""))
    return [ComparedFrame(key[1], key[2], frames[key]) for key in sorted(frames)]


def _parts(images: Path) -> Iterator[tuple[tuple[str, str, str], SheetParts]]:
    """Yield number, scene and frame of every test frame of a run with its parts."""
    for sheet in sorted(images.glob("test-*.png")):
        folder, match = images / PARTS / sheet.stem, FRAME_NAME.fullmatch(sheet.stem)
        if match is None:
            continue
        read = {name: cv2.imread(str(folder / f"{name}.png")) for name in SheetParts._fields if folder.is_dir()}
        found = {name: cv2.cvtColor(part, cv2.COLOR_BGR2RGB) for name, part in read.items() if part is not None}
        if missing := [name for name in SheetParts._fields if name not in found]:
            print(f"left out of the compared frames: {folder} lacks {', '.join(missing)}", file=sys.stderr, flush=True)
            continue
        yield (match[1], match[2], match[3]), SheetParts(**found)


def inline(image: np.ndarray, width: int) -> str:
    """Return an RGB image, scaled to a width, as a data URL."""
    return webp(fitted(image, width, cv2.INTER_AREA), WEBP_QUALITY)


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


FEW = 3
"""With at most so many rows, the list of runs stands before all tables: a newcomer looks for it first."""
FILES = ("config.yaml", "metrics.json", "table.md")

Section = dict[str, Any]
"""Name, title, kind (which selects the template) and the values for that template."""


def page(
    sweep: Sweep,
    plots: Mapping[str, tuple[str, str]],
    frames: Sequence[ComparedFrame],
    folder: Path,
    others: Mapping[str, Path],
) -> str:
    """Return the whole page, with links to runs and to the pages of other settings from its `folder`.

    `plots` has title and SVG of each plot by name.
    """
    drawn: list[Section | None] = [
        {"kind": "plot", "name": f"plot-{name}", "title": title, "svg": Markup(svg)}
        for name, (title, svg) in plots.items()
    ]
    named = [table.name for table in (*sweep.tables, *sweep.datasets)]
    filled, waiting = parts_with_runs(sweep)
    link = partial(path_between, folder)
    runs = [{"kind": "runs", "name": "runs", "title": "Runs", "rows": sweep.rows, "files": FILES, "link": link}]
    sections = [
        *runs[: len(sweep.rows) <= FEW],
        *drawn[:1],
        *({"kind": "text_table", "files": part.name in named, **part._asdict()} for part in filled),
        *drawn[1:],
        _frames(frames, sweep.runs, folder) if frames else None,
        *runs[len(sweep.rows) <= FEW :],
        {"kind": "waiting", "name": "waiting", "title": "Tables without a run", "parts": waiting} if waiting else None,
    ]
    content = {
        "remarks": [*sweep.remarks, SPREAD],
        "setting": sweep.setting,
        "others": {name: path_between(folder, path) for name, path in others.items()},
        "facts": _facts(sweep),
        "sections": [section for section in sections if section is not None],
    }
    return render("page.html.j2", content)


def _facts(sweep: Sweep) -> dict[str, str]:
    minutes = sum(run.facts.get(MINUTES) or 0.0 for run in sweep.runs)
    return {
        "Preset": sweep.runs[0].setting[0],
        "Steps": sweep.runs[0].setting[1],
        "Rows, runs": f"{len(sweep.rows)}, {len(sweep.runs)}",
        "Seeds": ", ".join(sorted({str(run.facts.get("seed", "?")) for run in sweep.runs})),
        "Training, occupancy stage": f"{minutes / 60:.1f} h in all",
        "Data": sweep.data or "recorded scenes",
    }


def viewer_link(folder: Path, run: FinishedRun, frame: ComparedFrame) -> str:
    """Return the link from a page in `folder` to a frame in the run's viewer page; empty if the run has none."""
    page = run.folder / PAGE
    return f"{path_between(folder, page)}{frame_address(frame.scene, frame.frame)}" if page.exists() else ""


def _frames(frames: Sequence[ComparedFrame], runs: Sequence[FinishedRun], folder: Path) -> Section:
    errors = [(f"difference: {name}" if k == 0 else name, rgb) for k, (name, rgb) in enumerate(ERRORS)]
    return {
        "kind": "frames",
        "name": "frames",
        "title": "Same frames, every row",
        "note": "Test frames, as the first seed of each row predicts them; the truth once for each grid.",
        "legend": [(name, "#{:02x}{:02x}{:02x}".format(*rgb)) for name, rgb in [*colors_of(runs).items(), *errors]],
        "frames": frames,
        "inline": inline,
        "viewer": partial(viewer_link, folder),
    }


def frame_address(scene: str, frame: str | int) -> str:
    """Return the end of the address of a page that opens a frame by its name; a number may have zeros before it."""
    return f"#{urlencode({'scene': scene, 'frame': frame}, quote_via=quote)}"


SETTINGS = 4
"""Most settings besides the first whose pages are named without --all."""


def write_report(sweeps: Sequence[Sweep], output: Path, whole: bool) -> None:
    """Write tables, plots and a page of every setting, and print a summary of the first, or `whole` all its tables."""
    first, *others = sweeps
    folders = {first.setting: output} | {sweep.setting: output / sweep.setting for sweep in others}
    pages = {setting: folder / "index.html" for setting, folder in folders.items()}
    if importlib.util.find_spec("matplotlib") is None:
        print(f"No plots: {NO_MATPLOTLIB}")
    with Progress("drawing", len(sweeps), unit="settings") as progress:
        for sweep in sweeps:
            folder = folders[sweep.setting]
            write_tables(sweep, folder)
            links = {setting: path for setting, path in pages.items() if setting != sweep.setting}
            plots, frames = draw(sweep, folder), compared_frames(sweep.rows)
            atomic_write(folder / "index.html", page(sweep, plots, frames, folder, links))
            progress.advance()
    links = [f"setting {setting}: {path}" for setting, path in list(pages.items())[1:]]
    print(report_markdown(first) if whole else f"{summary(first)}\n")
    for link in links if whole else first_lines(links, SETTINGS, "settings"):
        print(link)
    print(f"tables  {output / 'report.md'}{'' if whole else ' (--all prints them)'}\npage    {output / 'index.html'}")


def draw(sweep: Sweep, output: Path) -> dict[str, tuple[str, str]]:
    """Write every plot as SVG below `output`, and return title and `<svg>` element of each by name."""
    if importlib.util.find_spec("matplotlib") is None:
        return {}
    from omniocc.report.plots import PLOTS, as_svg, drops, learning_curves, without_math

    drawn = {}
    plots = {name: (title, partial(plot, without_math(sweep.rows))) for name, (title, plot) in PLOTS.items()}
    if rows := training.runs_by_row(sweep):
        plots["learning-curves"] = (training.CURVES_TITLE, partial(learning_curves, without_math(rows)))
    if sweep.robustness:
        plots["robustness"] = (disturbed.TITLE, partial(drops, disturbed.comparable(sweep.robustness)[0]))
    for name, (title, plot) in plots.items():
        if figure := plot():  # one at a time: a figure takes 10 MB
            file, element = as_svg(figure, name, title)
            atomic_write(output / "plots" / f"{name}.svg", file)
            drawn[name] = (title, element)
    return drawn
