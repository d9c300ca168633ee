"""A web page on a sweep in a single file, with links only to files of runs: `templates/page.html.j2`."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

from markupsafe import Markup

from omniocc.draw.bev import ERRORS
from omniocc.report.chapters import SPREAD, parts_of
from omniocc.report.frames import ComparedFrame, inline
from omniocc.report.html import render
from omniocc.report.runs import FinishedRun, colors_of, path_between
from omniocc.report.sweep import Sweep
from omniocc.runs.folder import PAGE
from omniocc.runs.results import MINUTES

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
    sections = [
        *drawn[:1],
        *({"kind": "text_table", "files": part.name in named, **part._asdict()} for part in parts_of(sweep)),
        *drawn[1:],
        _frames(frames, sweep.runs, folder) if frames else None,
        {
            "kind": "runs",
            "name": "runs",
            "title": "Runs",
            "rows": sweep.rows,
            "files": FILES,
            "link": partial(path_between, folder),
        },
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
        "Data": sweep.data or "not on this machine",
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
