"""The tables of a report as text and as files."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from omniocc.io import atomic_write
from omniocc.report.datasets import dataset_csv, dataset_latex, dataset_part
from omniocc.report.runs import FinishedRun, grid_name, path_between
from omniocc.report.sweep import Sweep
from omniocc.report.tables import budget, robustness, training
from omniocc.report.tables.budget import overview_keys, table_of_runs
from omniocc.report.tables.formats import Part, parts_text
from omniocc.report.tables.names import method_names
from omniocc.report.tables.paper import PaperTable, as_csv, as_latex, runs_of, table_cells
from omniocc.report.tables.protocol import protocol_lines
from omniocc.report.tables.verdicts import verdicts_parts
from omniocc.runs.table import SCORES, Cells, number

SPREAD = "± is the standard error over seeds everywhere: of a mean, or of a gap between two methods."
BOUNDS_TITLE = "Baseline and upper bound"
BOUNDS_NOTE = (
    "Baseline: the most frequent training class of every voxel, which needs no image. Upper bound: the true voxels, "
    "scored as if predicted. Its surface RayIoU shows what the cells of the grid lose. A prediction can score a little "
    "more in a class, since the class with the most points in a cell is not what every ray meets there."
)
BOUNDS_COLUMNS = {
    f"{title}, {SCORES[kind]}": f"{row}/{kind}"
    for row, title in {"prior": "Baseline", "label": "Upper bound"}.items()
    for kind in ("rayiou", "lidar/rayiou")
}


def parts_of(sweep: Sweep) -> list[Part]:
    """Return all tables of a report."""
    return [
        *verdicts_parts(sweep.tables, sweep.table_rows, sweep.claims),
        bounds_part(sweep),
        *map(dataset_part, sweep.datasets),
        *(table_part(table, sweep) for table in sweep.tables),
        *training.changes_part(sweep),
        *robustness.report_parts(sweep.robustness),
        budget_part(sweep, sweep.rows),
    ]


def report_markdown(sweep: Sweep) -> str:
    """Return all tables in one text."""
    counted = protocol_lines(sweep.rows, overview_keys(sweep.runs))
    runs = Part("runs", "All runs", "\n\n".join(counted), table_of_runs(sweep.runs))
    return "\n\n".join([*sweep.remarks, SPREAD, parts_text([runs, *parts_of(sweep)])]) + "\n"


def table_part(table: PaperTable, sweep: Sweep) -> Part:
    """Return a table of methods with its note, and how their scores were counted."""
    counted = protocol_lines(runs_of(table, sweep.table_rows), table.columns)
    note = "\n\n".join(filter(None, [table.note, *counted]))
    return Part(table.name, table.heading, note, table_cells(table, sweep.table_rows))


def bounds_part(sweep: Sweep) -> Part:
    """Return the scores of the baseline and of the true voxels on each grid."""
    counted = protocol_lines(sweep.rows, BOUNDS_COLUMNS.values())
    return Part("bounds", BOUNDS_TITLE, "\n\n".join([BOUNDS_NOTE, *counted]), bounds_cells(sweep.rows))


def bounds_cells(rows: Mapping[str, Sequence[FinishedRun]]) -> Cells:
    """Return the head and a line for each grid, with RayIoU of the baseline and of the true voxels."""
    grids = {grid_name(run.config): run for runs in rows.values() for run in runs[:1]}
    lines = [[grid, *(number(run.metrics.get(key)) for key in BOUNDS_COLUMNS.values())] for grid, run in grids.items()]
    return ["Grid", *BOUNDS_COLUMNS], lines


def budget_part(sweep: Sweep, listed: budget.Rows) -> Part:
    """Return what the `listed` rows were given and what they cost."""
    cells = budget.budget_cells(listed, method_names(sweep.tables))
    return Part("budget", budget.TITLE, budget.note(listed), cells)


def run_list(sweep: Sweep, folder: Path) -> str:
    """Return a list of the runs: a link from a folder to each that has one, and the command that made it."""
    lines = ["## Runs", ""]
    for run in (run for runs in sweep.rows.values() for run in runs):
        where = run.link and path_between(folder, run.link)
        name = f"[{run.name}]({where}/) ([config.yaml]({where}/config.yaml))" if where else run.name
        lines.append(f"- {name}: `{run.command or 'command not recorded'}`")
    return "\n".join([*lines, ""])


def write_tables(sweep: Sweep, output: Path) -> None:
    """Write `report.md`, and every table as CSV and LaTeX."""
    atomic_write(output / "report.md", f"{report_markdown(sweep)}\n{run_list(sweep, output)}")
    for table in sweep.tables:
        atomic_write(output / f"{table.name}.csv", as_csv([(table, sweep.table_rows)]))
        atomic_write(output / f"{table.name}.tex", as_latex(table, sweep.table_rows))
    for datasets in sweep.datasets:
        atomic_write(output / f"{datasets.name}.csv", dataset_csv(datasets))
        atomic_write(output / f"{datasets.name}.tex", dataset_latex(datasets))
