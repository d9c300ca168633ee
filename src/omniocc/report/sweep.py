"""The content of a report, and its tables as files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from omniocc.io import atomic_write
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
from omniocc.report.plots.curves import read_curve
from omniocc.report.rows import assign_rows
from omniocc.report.runs import FinishedRun, path_between, read_runs
from omniocc.report.selection import by_row, comparable, settings_of
from omniocc.report.tables import bounds, budget
from omniocc.report.tables.claims import claim_cells
from omniocc.report.tables.overview import table_of_runs
from omniocc.report.tables.paper import PaperTable, as_csv, as_latex, as_markdown, is_table, load_table
from omniocc.report.tables.robustness import robustness_markdown
from omniocc.run.folder import METRICS
from omniocc.run.robustness import Robustness, read_robustness
from omniocc.run.table import markdown

GENERATED = "<!-- Written by `python src/report.py --runs docs/results/runs --docs docs/results`; do not edit. -->"

ROBUSTNESS = "robustness"
"""Name of the chapter on tests under disturbances."""


class Sweep(NamedTuple):
    """Comparable runs and the paper's tables.

    Attributes:
        runs: comparable runs, by falling RayIoU.
        rows: runs of each row, in the order of the tables, then those of rows that are in no table.
        remark: on common settings of the runs, and on runs that are left out.
        data: scenes and frames of the dataset; empty if it is not on this machine.
        tables: tables of methods.
        datasets: tables of datasets.
        unfinished: runs that have begun and not finished, with the last step recorded.
        lengths: runs of all settings of the same preset by `row@steps`, which rows of tables may name.
        robustness: tests under disturbances of these runs; the first sweep of a report has those of other files too.
    """

    runs: list[FinishedRun]
    rows: Mapping[str, Sequence[FinishedRun]]
    remark: str
    data: str
    tables: Sequence[PaperTable]
    datasets: Sequence[DatasetTable]
    unfinished: Sequence[str] = ()
    lengths: Mapping[str, Sequence[FinishedRun]] = MappingProxyType({})
    robustness: Sequence[Robustness] = ()

    @property
    def setting(self) -> str:
        """Return preset, steps and data in a word, for the name of a folder."""
        preset, steps, data = self.runs[0].setting
        return f"{preset}-{steps}-{data[:8]}"

    @property
    def table_rows(self) -> Mapping[str, Sequence[FinishedRun]]:
        """Return the runs of everything that a row of a table may name."""
        return {**self.lengths, **self.rows}

    @property
    def not_run(self) -> list[str]:
        """Return the rows of the tables without a run."""
        rows = dict.fromkeys(row.run for table in self.tables for row in table.rows)
        return [row for row in rows if row not in self.table_rows]

    @property
    def remarks(self) -> list[str]:
        """Return sentences on the runs of the report, and on those left out, missing or unfinished."""
        missing = [f"Not run: {', '.join(self.not_run)}."] if self.not_run else []
        begun = [f"Begun, not finished: {', '.join(self.unfinished)}."] if self.unfinished else []
        return [self.remark, *missing, *begun]


def read_sweeps(runs: Path, tables: Path, conf: Path, preset: str | None) -> list[Sweep]:
    """Return the finished runs of a folder with the tables of another, apart by preset, steps and data.

    The setting that most runs have is the first. The folder `conf` has the rows. A preset leaves out the others.

    Raises:
        UserError: when there is no run, none of that preset, or a table or row is broken.
    """
    paths = sorted(tables.glob("*.yaml"))
    found = sorted((load_table(path) for path in paths if is_table(path)), key=lambda table: table.number or len(paths))
    first = list(dict.fromkeys(["ours", *(row.run for table in found for row in table.rows)]))
    finished = assign_rows(read_runs(runs), conf, first)
    tests, names = read_robustness(runs), {run.name for run in finished}

    def sweep_of(setting: tuple[str, ...]) -> Sweep:
        kept, remark = comparable(finished, setting)
        datasets = [with_ours(load_dataset_table(path), kept) for path in paths if is_dataset_table(path)]
        rows, scenes = by_row(kept), scenes_of(kept[0])
        order = [row for row in dict.fromkeys([*first, *rows]) if row in rows]
        data = facts_of_scenes(scenes) if scenes else ""
        own = [test for test in tests if test.system in {run.name for run in kept}]
        ordered = {row: rows[row] for row in order}
        return Sweep(kept, ordered, remark, data, found, datasets, unfinished(runs), robustness=own)

    sweeps = [sweep_of(setting) for setting in settings_of(finished, preset)]
    others = [test for test in tests if test.system not in names]
    sweeps[0] = sweeps[0]._replace(robustness=[*sweeps[0].robustness, *others])
    return [sweep._replace(lengths=by_length(sweeps, sweep.runs[0].setting[0])) for sweep in sweeps]


def read_sweep(runs: Path, tables: Path, conf: Path, preset: str | None) -> Sweep:
    """Return the first of `read_sweeps`: the runs of the setting that most runs have."""
    return read_sweeps(runs, tables, conf, preset)[0]


def by_length(sweeps: Sequence[Sweep], preset: str) -> dict[str, Sequence[FinishedRun]]:
    """Return the runs of a preset by `row@steps`; of two datasets, those of the one with more runs."""
    found: dict[str, Sequence[FinishedRun]] = {}
    for sweep in sweeps:
        if sweep.runs[0].setting[0] == preset:
            for row, runs in sweep.rows.items():
                found.setdefault(f"{row}@{runs[0].setting[1]}", runs)
    return found


def unfinished(runs: Path) -> list[str]:
    """Return runs of a folder that have a configuration and no figures yet: still training, or stopped."""
    found = []
    for path in sorted(runs.glob("*/config.yaml")):
        if not (path.parent / METRICS).exists():
            step = max(read_curve(path.parent, "train/loss"), default=0)
            found.append(f"{path.parent.name} (step {step})")
    return found


def chapters(sweep: Sweep) -> dict[str, str]:
    """Return every table as Markdown under a heading of level 2, by name."""
    baseline = f"## {bounds.TITLE}\n\n{bounds.NOTE}\n\n{markdown(*bounds.bounds_cells(sweep.rows))}"
    cost = f"## Budget\n\n{budget.NOTE}\n\n{markdown(*budget.budget_cells(sweep.rows))}"
    datasets = {table.name: dataset_markdown(table) for table in sweep.datasets}
    papers = {}
    for table in sweep.tables:
        head, claims = claim_cells(table, sweep.rows)
        text = as_markdown(table, sweep.table_rows)
        papers[table.name] = "\n".join([text, *([markdown(head, claims)] if claims else [])])
    tests = {ROBUSTNESS: robustness_markdown(sweep.robustness)} if sweep.robustness else {}
    return {"bounds": baseline, **datasets, **papers, **tests, "budget": cost}


def report_markdown(sweep: Sweep) -> str:
    """Return all tables in one text."""
    remarks = " ".join(sweep.remarks) + "\n"
    return "\n".join([remarks, markdown(*table_of_runs(sweep.runs)), *chapters(sweep).values()])


def write_docs(sweep: Sweep, folder: Path) -> list[Path]:
    """Write every table as a page of the documentation, `<table>.md`, and return the files.

    Existing pages are overwritten.

    Raises:
        DataError: naming the file that cannot be written.
    """
    written = []
    for name, chapter in chapters(sweep).items():
        written.append(folder / f"{name}.md")
        remark = "" if name == ROBUSTNESS else f"\n{sweep.remark}\n"  # which tells of the runs of a table
        atomic_write(written[-1], f"{GENERATED}\n\n{chapter.replace('## ', '# ', 1)}{remark}")
    return written


def run_list(sweep: Sweep, folder: Path) -> str:
    """Return a list of the runs: a link from a folder to each, and the command that made it."""
    lines = ["## Runs", ""]
    for run in (run for runs in sweep.rows.values() for run in runs):
        where = path_between(folder, run.folder)
        command = str(run.facts.get("command", "command not recorded"))
        lines.append(f"- [{run.name}]({where}/) ([config.yaml]({where}/config.yaml)): `{command}`")
    return "\n".join([*lines, ""])


def write_tables(sweep: Sweep, output: Path) -> None:
    """Write `report.md`, and every table as CSV and LaTeX."""
    output.mkdir(parents=True, exist_ok=True)
    atomic_write(output / "report.md", f"{report_markdown(sweep)}\n{run_list(sweep, output)}")
    for table in sweep.tables:
        atomic_write(output / f"{table.name}.csv", as_csv(table, sweep.table_rows))
        atomic_write(output / f"{table.name}.tex", as_latex(table, sweep.table_rows))
    for datasets in sweep.datasets:
        atomic_write(output / f"{datasets.name}.csv", dataset_csv(datasets))
        atomic_write(output / f"{datasets.name}.tex", dataset_latex(datasets))
