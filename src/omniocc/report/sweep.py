"""Everything a report is made of, and the files it becomes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from omniocc.io import atomic_write
from omniocc.report.tables.budget import BUDGET_NOTE, YARDSTICKS_NOTE, budget_cells, yardstick_cells
from omniocc.report.tables.claims import claim_cells
from omniocc.report.plots.curves import read_curve
from omniocc.report.dataset.table import (
    DatasetTable,
    dataset_csv,
    dataset_latex,
    dataset_markdown,
    facts_of_scenes,
    is_dataset_table,
    load_dataset_table,
    scenes_of,
    with_ours,
)
from omniocc.report.markup import path_between
from omniocc.report.tables.paper import PaperTable, as_csv, as_latex, as_markdown, is_table, load_table
from omniocc.report.rows import assign_rows
from omniocc.report.runs import FinishedRun, read_runs
from omniocc.report.selection import by_row, comparable
from omniocc.report.tables.overview import table_of_runs
from omniocc.run.folder import METRICS
from omniocc.run.table import markdown


class Sweep(NamedTuple):
    """Comparable runs and the paper's tables.

    Attributes:
        runs: by falling RayIoU.
        rows: runs of each row, in the order of the tables, then those that stand in none.
        remark: what the runs have in common, and what is left out.
        data: scenes and frames of the dataset; empty if it is not on this machine.
        tables: of methods.
        datasets: tables of datasets.
        unfinished: other runs that were begun, with their last step that was written down.
    """

    runs: list[FinishedRun]
    rows: Mapping[str, Sequence[FinishedRun]]
    remark: str
    data: str
    tables: Sequence[PaperTable]
    datasets: Sequence[DatasetTable]
    unfinished: Sequence[str] = ()

    @property
    def not_run(self) -> list[str]:
        """Rows of the tables without a run."""
        return [
            row for row in dict.fromkeys(row.run for table in self.tables for row in table.rows) if row not in self.rows
        ]


def read_sweep(runs: Path, tables: Path, conf: Path, preset: str | None) -> Sweep:
    """Collect the finished runs of a folder and the tables of another.

    Args:
        runs: folder of runs.
        tables: folder of the tables.
        conf: folder of the configuration, which says what the rows are.
        preset: of the runs; None takes the setting that most runs have.

    Raises:
        UserError: when there is no run, none of that preset, or a table or row is broken.
    """
    paths = sorted(tables.glob("*.yaml"))
    found = sorted((load_table(path) for path in paths if is_table(path)), key=lambda table: table.number)
    first = list(dict.fromkeys(["ours", *(row.run for table in found for row in table.rows)]))
    kept, remark = comparable(assign_rows(read_runs(runs), conf, first), preset)
    datasets = [with_ours(load_dataset_table(path), kept) for path in paths if is_dataset_table(path)]
    rows, scenes = by_row(kept), scenes_of(kept[0])
    order = [row for row in dict.fromkeys([*first, *rows]) if row in rows]
    data = facts_of_scenes(scenes) if scenes else ""
    return Sweep(kept, {row: rows[row] for row in order}, remark, data, found, datasets, unfinished(runs))


def unfinished(runs: Path) -> list[str]:
    """Runs of a folder that have a configuration and no figures yet: still training, or stopped."""
    found = []
    for path in sorted(runs.glob("*/config.yaml")):
        if not (path.parent / METRICS).exists():
            step = max(read_curve(path.parent, "train/loss"), default=0)
            found.append(f"{path.parent.name} (step {step})")
    return found


def open_ends(sweep: Sweep) -> list[str]:
    """Sentences on what has not been run and what has not ended."""
    missing = f"Not run: {', '.join(sweep.not_run)}."
    begun = f"Begun, not finished: {', '.join(sweep.unfinished)}."
    return [missing] * bool(sweep.not_run) + [begun] * bool(sweep.unfinished)


def report_markdown(sweep: Sweep) -> str:
    """All tables in one text."""
    parts = [
        f"{' '.join([sweep.remark, *open_ends(sweep)])}\n",
        markdown(*table_of_runs(sweep.runs)),
        f"## Yardsticks\n\n{YARDSTICKS_NOTE}\n\n{markdown(*yardstick_cells(sweep.rows))}",
        *map(dataset_markdown, sweep.datasets),
    ]
    for table in sweep.tables:
        parts.append(as_markdown(table, sweep.rows))
        head, claims = claim_cells(table, sweep.rows)
        parts += [markdown(head, claims)] * bool(claims)
    parts.append(f"## Budget\n\n{BUDGET_NOTE}\n\n{markdown(*budget_cells(sweep.rows))}")
    return "\n".join(parts)


def run_list(sweep: Sweep, folder: Path) -> str:
    """Where each run lies, seen from a folder, and the command that made it."""
    lines = ["## Runs", ""]
    for run in (run for runs in sweep.rows.values() for run in runs):
        where = path_between(folder, run.folder)
        command = str(run.facts.get("command", "command not recorded"))
        lines.append(f"- [{run.name}]({where}/) ([config.yaml]({where}/config.yaml)): `{command}`")
    return "\n".join([*lines, ""])


def write_tables(sweep: Sweep, output: Path) -> None:
    """`report.md`, and every table as CSV and LaTeX."""
    output.mkdir(parents=True, exist_ok=True)
    atomic_write(output / "report.md", f"{report_markdown(sweep)}\n{run_list(sweep, output)}")
    for table in sweep.tables:
        atomic_write(output / f"{table.name}.csv", as_csv(table, sweep.rows))
        atomic_write(output / f"{table.name}.tex", as_latex(table, sweep.rows))
    for datasets in sweep.datasets:
        atomic_write(output / f"{datasets.name}.csv", dataset_csv(datasets))
        atomic_write(output / f"{datasets.name}.tex", dataset_latex(datasets))
