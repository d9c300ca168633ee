"""The generated pages of results in the documentation, and the CSV beside them."""

import importlib.util
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from omniocc.errors import UserError, installing
from omniocc.io import atomic_write, read_bytes, text_of
from omniocc.progress import Progress
from omniocc.report.chapters import BOUNDS_NOTE, SPREAD, bounds_part, budget_part
from omniocc.report.datasets import dataset_csv, dataset_part
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import Sweep
from omniocc.report.tables import robustness, training
from omniocc.report.tables.budget import minutes_in_all, records
from omniocc.report.tables.claims import Rows, rows_in
from omniocc.report.tables.formats import Part, csv_text, parts_text
from omniocc.report.tables.learning_rates import learning_rates_csv
from omniocc.report.tables.names import method_names, named
from omniocc.report.tables.paper import PAGES, PAPER, PaperTable, as_csv, table_cells
from omniocc.report.tables.power import power_csv
from omniocc.report.tables.protocol import protocol_list
from omniocc.report.tables.results import COMMAND, of_paper, remark_lines, results_lines
from omniocc.report.tables.tried import tried_csv
from omniocc.report.tables.verdicts import CSV_HEAD, csv_lines, verdicts_parts

GENERATED = f"<!-- Written by `{COMMAND}`; do not edit. -->"
BEGIN, END = f"<!-- Results, written by `{COMMAND}`; do not edit. -->", "<!-- End of the results. -->"
"""Lines around the results on their page and in the README."""
TRIED_AGAINST = "extended"
"""Row to which `tried.csv` compares all others."""
CURVES_IMAGE = "learning_curves.svg"
"""Image of the learning curves, in the folder of the pages."""
NO_MATPLOTLIB = f"matplotlib is missing: {installing('plot')}"
TITLES = {
    "index": "The paper's claims, at small scale",
    PAPER: "The paper's tables, trained here",
    "systems": "Other systems",
    "beyond": "Beyond the paper",
    "robustness": "What breaks the models",
    "appendix/claims": "All claims, with errors and p-values",
    "appendix/breakdowns": "By class, place, weather and motion",
    "appendix/costs": "Costs and bounds",
}
"""Title of each page, by its path."""
MORE = (
    f"{SPREAD} Pages have means alone; the spread is in the appendix and in the CSV files.",
    "[The paper's Tables I to VII](paper.md), [other systems](systems.md), [beyond the paper](beyond.md), "
    "[robustness](robustness.md), [method](method.md). Appendix: [all claims](appendix/claims.md), [by class, place, "
    "weather and motion](appendix/breakdowns.md), [costs](appendix/costs.md), [deviations from the plan]"
    "(appendix/deviations.md).",
    "CSV: every table by its name, [all claims](csv/claims.csv), [all runs with commands](csv/runs.csv), "
    "[runs of other presets](csv/presets.csv), [learning curves](csv/training.csv), [changes that were tried]"
    "(csv/tried.csv), [learning rates](csv/learning_rates.csv), [seeds that a gap needs](csv/power.csv).",
)
MEANS = "Means over seeds. Scores 'here' are of the runs of this repository."
COUNTED_TITLE = "How scores are counted"
COUNTED = f"[{COUNTED_TITLE}]({{}}{PAPER}.md#{COUNTED_TITLE.lower().replace(' ', '-')})."
DISTURBANCES = "What each disturbance is: [What breaks a model](../how_to/robustness.md)."


def write_documentation(sweeps: Sequence[Sweep], folder: Path, root: Path) -> None:
    """Write pages, CSV and learning curves of all results; for `docs/results` below `root` the README's results too."""
    write_docs(sweeps, folder)
    if folder.resolve() == root / "docs" / "results":
        write_block(root / "README.md", results_block(sweeps[0]))
    draw_curves(sweeps[0], folder)


def draw_curves(sweep: Sweep, folder: Path) -> None:
    """Draw the learning curves into a folder of documentation, if rows have run with several numbers of steps."""
    names = method_names(sweep.tables)
    rows = {names.get(row, row): runs for row, runs in training.runs_by_row(sweep).items()}
    if not rows:
        return
    if importlib.util.find_spec("matplotlib") is None:
        print(f"{CURVES_IMAGE} is not drawn again: {NO_MATPLOTLIB}")
        return
    from omniocc.report.plots import learning_curves, save_svg

    if figure := learning_curves(rows):
        save_svg(figure, folder / CURVES_IMAGE)


def write_docs(sweeps: Sequence[Sweep], folder: Path) -> list[Path]:
    """Write the pages of results and the CSV files beside them, and return the files.

    They depend on the records of the runs and on the tables alone. Existing ones are overwritten.

    Raises:
        DataError: naming the file that cannot be written.
    """
    files, written = files_of(sweeps), []
    with Progress("writing results", len(files), unit="files") as progress:
        for name, compose in files.items():
            if text := compose():
                written.append(folder / name)
                atomic_write(written[-1], text)
            progress.advance()
    return written


def files_of(sweeps: Sequence[Sweep]) -> dict[str, Callable[[], str]]:
    """Return what composes the text of each file, by its path; the text is empty where there is nothing to tell."""
    sweep, every = documented(sweeps[0]), [run for each in sweeps for run in each.runs]
    pages: dict[str, Callable[[], str]] = {page: partial(tables_page, page, sweep) for page in PAGES}
    pages |= {
        "index": partial(results_page, sweep),
        "robustness": partial(robustness_page, sweep),
        "appendix/claims": partial(claims_page, sweep),
        "appendix/costs": partial(costs_page, sweep),
    }
    found = {f"{page}.md": partial(page_text, page, compose) for page, compose in pages.items()}
    return found | {f"csv/{name}.csv": compose for name, compose in csv_files(sweep, every).items()}


def csv_files(sweep: Sweep, every: Sequence[FinishedRun]) -> dict[str, Callable[[], str]]:
    """Return what composes the text of each CSV file, by its name."""
    names, preset = method_names(sweep.tables), sweep.runs[0].setting[0]
    others = [run for run in every if run.setting[0] != preset]
    tests = sweep.robustness
    by_table: dict[str, list[tuple[PaperTable, Rows]]] = {}
    for each in training.by_steps(sweep).values():
        for table in each.tables:
            by_table.setdefault(table.name, []).append((table, each.table_rows))
    found: dict[str, Callable[[], str]] = {name: partial(as_csv, tables) for name, tables in by_table.items()}
    found |= {table.name: partial(dataset_csv, table) for table in sweep.datasets}
    return found | {
        "claims": lambda: claims_csv(sweep),
        "runs": lambda: records(every),
        "presets": lambda: records(others) if others else "",
        "training": lambda: training.training_csv(training.runs_by_row(sweep), names),
        "tried": lambda: tried_csv(every, TRIED_AGAINST) if any(run.row == TRIED_AGAINST for run in every) else "",
        "learning_rates": lambda: learning_rates_csv(every),
        "power": lambda: power_csv(sweep.tables, sweep.table_rows, sweep.seed_stds),
        "robustness": lambda: robustness.robustness_csv(tests, names) if tests else "",
    }


def page_text(page: str, compose: Callable[[], str]) -> str:
    """Return a page below its title; empty if it has nothing to tell."""
    text = compose()
    return f"{GENERATED}\n\n# {TITLES[page]}\n\n{text.strip()}\n" if text else ""


def results_page(sweep: Sweep) -> str:
    """Return the page of all results; empty without a table of the paper."""
    if not of_paper(sweep):
        return ""
    return "\n\n".join(["\n".join(results_block(sweep)), "\n".join(remark_lines(sweep)), *MORE])


def tables_page(page: str, sweep: Sweep) -> str:
    """Return the tables of a page, means alone, each with its note and runs below."""
    tables = [table for table in sweep.tables if table.page == page]
    root = "../" * page.count("/")
    parts = [dataset_part(table) for table in sweep.datasets] if page == PAPER else []
    parts += [
        Part(
            table.name,
            table.heading,
            f"{table.note}\n\n{source(table, sweep)} With the spread: [{table.name}.csv]({root}csv/{table.name}.csv).",
            table_cells(table, sweep.table_rows, errors=False),
        )
        for table in tables
    ]
    counted = counted_text(sweep) if page == PAPER else COUNTED.format(root)
    return "\n\n".join([MEANS, parts_text(parts), counted]) if tables else ""


def counted_text(sweep: Sweep) -> str:
    """Return how the scores of all tables were counted, as a section of a page."""
    keys = dict.fromkeys(key for table in sweep.tables for key in table.columns)
    names = method_names(sweep.tables)
    rows = {named(row, names): runs for row, runs in rows_in(sweep.tables, sweep.table_rows).items()}
    return "\n\n".join([f"## {COUNTED_TITLE}", "The same for all pages of results.", *protocol_list(rows, keys)])


def source(table: PaperTable, sweep: Sweep) -> str:
    """Return a sentence on the runs of a table: their number, seeds and hours."""
    runs = {run.name: run for runs in rows_in([table], sweep.table_rows).values() for run in runs}.values()
    seeds = sorted({str(run.facts.get("seed", "?")) for run in runs}, key=lambda seed: (len(seed), seed))
    hours = sum(map(minutes_in_all, runs)) / 60
    following = len(seeds) > 2 and seeds == [str(seed) for seed in range(len(seeds))]
    ends = f"0 to {seeds[-1]}" if following else ", ".join(seeds)
    return f"{len(runs)} runs, seeds {ends}, {hours:.1f} hours of training."


def robustness_page(sweep: Sweep) -> str:
    """Return the mean losses by kind of disturbance; empty without a test."""
    if not sweep.robustness:
        return ""
    parts = robustness.page_parts(sweep.robustness, sweep.runs[0].setting[1], method_names(sweep.tables))
    files = "Every disturbance alone, with errors over scenes and commands: [robustness.csv](csv/robustness.csv)."
    return "\n\n".join([robustness.NOTE, parts_text(parts), DISTURBANCES, files])


def claims_page(sweep: Sweep) -> str:
    """Return every claim with errors and p-values, what changes with more steps, and the learning curves."""
    parts = verdicts_parts(sweep.tables, sweep.table_rows, sweep.claims)
    changes = training.changes_part(sweep)
    image = f"![Validation RayIoU over the steps](../{CURVES_IMAGE})"
    curves = f"## {training.CURVES_TITLE}\n\n{image}\n\n{training.CURVES}"
    files = "All numbers, for every number of steps: [claims.csv](../csv/claims.csv)."
    shown = [curves] if training.runs_by_row(sweep) else []
    return "\n\n".join([f"{SPREAD} {files}", parts_text([*parts, *changes]), *shown]) if parts else ""


def costs_page(sweep: Sweep) -> str:
    """Return what the rows of the tables cost, and the bounds of scores on each grid."""
    bounds = bounds_part(sweep)._replace(note=BOUNDS_NOTE)
    parts = [budget_part(sweep, rows_in(sweep.tables, sweep.table_rows)), bounds]
    return "\n\n".join([parts_text(parts), COUNTED.format("../")])


def claims_csv(sweep: Sweep) -> str:
    """Return CSV of all claims for every number of steps."""
    lines = [
        line
        for steps, each in training.by_steps(sweep).items()
        for line in csv_lines(each.tables, each.table_rows, each.claims, steps)
    ]
    return csv_text(CSV_HEAD, lines)


def documented(sweep: Sweep) -> Sweep:
    """Return a sweep with the tables of the documentation, and what they say of its runs."""
    tables = [table._replace(note=f"{table.note} {table.here}".strip()) for table in sweep.tables if table.page]
    return sweep._replace(tables=tables, longer=[documented(longer) for longer in sweep.longer])


def results_block(sweep: Sweep) -> list[str]:
    """Return the lines that the page of all results and the README share, with the marks around them."""
    return [BEGIN, *results_lines(sweep), END]


def write_block(path: Path, block: Sequence[str]) -> None:
    """Write lines into a Markdown file in place of those between the same marks, the first and last of the lines.

    Raises:
        DataError: naming the file that cannot be read or written.
        UserError: if the file has no such marks.
    """
    (begin, *_, end), lines = block, text_of(read_bytes(path)).splitlines()
    first = lines.index(begin) if begin in lines else len(lines)
    if end not in lines[first:]:
        raise UserError(f"{path} has no place for the results; add two lines, {begin} and below it {end}")
    lines[first : lines.index(end, first) + 1] = block
    atomic_write(path, "\n".join([*lines, ""]))
