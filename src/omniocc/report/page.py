"""A web page on a sweep in a single file, with links only to files of runs: `templates/page.html.j2`."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import Markup

from omniocc.report.dataset.table import dataset_cells
from omniocc.report.frames import ComparedFrame, inline
from omniocc.report.html import render
from omniocc.report.runs import FinishedRun, colors_of, path_between
from omniocc.report.sweep import Sweep
from omniocc.report.tables import bounds, budget, robustness, training, verdicts
from omniocc.report.tables.claims import Judged, Name, claim_cells
from omniocc.report.tables.paper import (
    Figure,
    PaperRow,
    PaperTable,
    has_paper,
    in_cell,
    order_line,
    rows_of,
    runs_of,
    source_of,
    with_spread,
)
from omniocc.report.tables.protocol import protocol_lines
from omniocc.run.results import MINUTES
from omniocc.run.table import Cells
from omniocc.view.bev import ERRORS
from omniocc.viewer.page import PAGE, frame_address

FILES = ("config.yaml", "metrics.json", "table.md")
WIDE_COLUMNS = 5
"""Tables with more columns are printed smaller and have their order below, as those with claims have it."""

Section = dict[str, Any]
"""Name, title, kind (which selects the template) and the values for that template."""


def page(
    sweep: Sweep, plots: Mapping[str, tuple[str, str]], frames: Sequence[ComparedFrame], folder: Path,
    others: Mapping[str, Path],
) -> str:  # fmt: skip
    """Return the whole page, with links to runs and to the pages of other settings from its `folder`.

    `plots` has title and SVG of each plot by name.
    """
    drawn: list[Section | None] = [
        {"kind": "plot", "name": f"plot-{name}", "title": title, "svg": Markup(svg)}
        for name, (title, svg) in plots.items()
    ]
    decided = sweep.claims
    sections = [
        *drawn[:1],
        _text_table(
            "bounds",
            bounds.TITLE,
            bounds.NOTE,
            bounds.bounds_cells(sweep.rows),
            protocol=protocol_lines(sweep.rows, bounds.COLUMNS.values()),
        ),
        *(
            _text_table(table.name, table.title, table.note, dataset_cells(table), files=True)
            for table in sweep.datasets
        ),
        *(_paper_table(table, sweep, decided) for table in sweep.tables),
        *(
            _text_table(*part)
            for part in [
                *verdicts.verdicts_parts(sweep.tables, sweep.table_rows, decided),
                *training.parts_of(sweep),
            ]
        ),
        *drawn[1:],
        *_robustness(sweep),
        _frames(frames, sweep.runs, folder) if frames else None,
        _text_table("budget", "Budget", budget.note(sweep.rows), budget.budget_cells(sweep.rows)),
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
        "remarks": sweep.remarks,
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


def _text_table(
    name: str, title: str, note: str, cells: Cells, files: bool = False,
    protocol: Sequence[str] = (),
) -> Section:  # fmt: skip
    content = {"title": title, "note": note, "head": cells[0], "rows": cells[1], "files": files, "protocol": protocol}
    return {"kind": "text_table", "name": name, **content}


def _robustness(sweep: Sweep) -> list[Section]:
    """Return a table of losses and one of drops for each setting of the tests under disturbances."""
    sections = []
    for number, tests in enumerate(robustness.comparable(sweep.robustness)):
        name = f"robustness-{number}" if number else "robustness"
        remarks = " ".join(
            [robustness.NOTE, robustness.verdict(tests), *map(robustness.facts_line, tests, robustness.names_of(tests))]
        )
        sections.append(_text_table(name, robustness.TITLE, remarks, robustness.relative_cells(tests)))
        sections.append(
            _text_table(f"{name}-parts", f"{robustness.TITLE}: part by part", "", robustness.part_cells(tests))
        )
    return sections


def _paper_table(table: PaperTable, sweep: Sweep, decided: Mapping[Name, Judged]) -> Section:
    claims_head, claims = claim_cells(table, sweep.table_rows, decided)
    return {
        "kind": "paper_table",
        "name": table.name,
        "title": table.title,
        "note": table.note,
        "wide": len(table.columns) > WIDE_COLUMNS,
        "stacked": len(table.columns) > WIDE_COLUMNS or bool(claims),
        "columns": list(table.columns.values()),
        "methods": [_method(table, row, figures, sweep) for row, figures in rows_of(table, sweep.table_rows)],
        "order": order_line(table, sweep.table_rows),
        "claims_head": claims_head,
        "claims": claims,
        "protocol": protocol_lines(runs_of(table, sweep.table_rows), table.columns),
    }


def _method(table: PaperTable, row: PaperRow, figures: Sequence[Figure | None], sweep: Sweep) -> dict[str, Any]:
    """Return the paper's figures, and ours as mean and standard deviation; `row` is the anchor of links to its runs."""
    ours = [with_spread(key, figure).partition(" ± ") for key, figure in zip(table.columns, figures, strict=True)]
    return {
        "title": row.title,
        "row": row.run if row.run in sweep.rows else "",
        "paper": [in_cell(key, value) for key, value in row.paper.items()] if has_paper(row) else [],
        "source": source_of(figures),
        "ours": [(mean, std) for mean, _, std in ours],
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
