"""The tables of a report as text and as files."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from omniocc.io import atomic_write
from omniocc.report.datasets import dataset_csv, dataset_latex, dataset_part
from omniocc.report.runs import UNKNOWN, FinishedRun, grid_name, path_between
from omniocc.report.sweep import Sweep
from omniocc.report.tables import budget, robustness, training
from omniocc.report.tables.budget import overview_keys, table_of_runs
from omniocc.report.tables.formats import Part, parts_text
from omniocc.report.tables.names import method_names
from omniocc.report.tables.paper import PaperTable, as_csv, as_latex, has_paper, runs_of, table_cells
from omniocc.report.tables.protocol import protocol_lines
from omniocc.report.tables.verdicts import HEAD, NOT_RUN, verdicts_parts
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


def parts_with_runs(sweep: Sweep) -> tuple[list[Part], list[tuple[Part, str]]]:
    """Return the tables of a page: those with a run, and those without, each with the command that fills it.

    In the former, rows with a run stand first, and those with neither a run nor a figure of the paper are left out, as
    are claims on methods that have not run; the note counts them.
    """
    empty = {table.name for table in sweep.tables if not runs_of(table, sweep.table_rows)}
    preset = sweep.runs[0].setting[0]
    command = "python src/train.py --multirun +sweep={}" + f" preset={preset}" * (preset != UNKNOWN)
    parts = parts_of(sweep._replace(tables=[_run_first(table, sweep) for table in sweep.tables]))
    filled = [_decided(part) for part in parts if part.name not in empty]
    waiting = [(table_part(table, sweep), command.format(table.name)) for table in sweep.tables if table.name in empty]
    return [part for part in filled if part.cells[1]], waiting


def _run_first(table: PaperTable, sweep: Sweep) -> PaperTable:
    """Return a table with the rows that have run first, and of the others only those that the paper has figures of."""
    kept = [row for row in table.rows if row.run in sweep.table_rows or has_paper(row)]
    count = len(table.rows) - len(kept)
    note = f"{table.note}\n\nNot run and not shown: {count} rows." if count else table.note
    return table._replace(rows=sorted(kept, key=lambda row: row.run not in sweep.table_rows), note=note.strip())


def _decided(part: Part) -> Part:
    """Return a table of claims without those on methods that have not run; other tables as they are."""
    head, lines = part.cells
    if head != HEAD:
        return part
    kept = [line for line in lines if line[HEAD.index("Verdict")] != NOT_RUN]
    count = len(lines) - len(kept)
    return part._replace(
        cells=(head, kept), note=f"{part.note} Not run and not shown: {count} claims." if count else part.note
    )


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
