"""The tables of a report as text and as files."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from omniocc.errors import UserError
from omniocc.io import atomic_write, read_bytes, text_of
from omniocc.report.dataset.table import dataset_csv, dataset_latex, dataset_markdown
from omniocc.report.runs import FinishedRun, path_between
from omniocc.report.sweep import Sweep
from omniocc.report.tables import bounds, budget, training
from omniocc.report.tables.claims import Judged, Name, Rows, claim_cells, rows_in, rows_of_claims
from omniocc.report.tables.formats import parts_text
from omniocc.report.tables.learning_rates import learning_rates
from omniocc.report.tables.overview import overview_keys, records, table_of_runs
from omniocc.report.tables.paper import PaperTable, as_csv, as_latex, as_markdown
from omniocc.report.tables.power import power_chapter
from omniocc.report.tables.presets import presets_chapter
from omniocc.report.tables.protocol import protocol_text
from omniocc.report.tables.results import COMMAND, NUMERALS, of_paper, results_lines
from omniocc.report.tables.robustness import robustness_markdown
from omniocc.report.tables.tried import tried_chapter
from omniocc.report.tables.verdicts import verdicts_parts
from omniocc.run.table import markdown

GENERATED = f"<!-- Written by `{COMMAND}`; do not edit. -->"
BEGIN, END = f"<!-- Results, written by `{COMMAND}`; do not edit. -->", "<!-- End of the results. -->"
"""Lines around the results on their page and in the README."""
TRIED_AGAINST = "extended"
"""Row to which the page `accuracy` compares all others."""
CURVES_IMAGE = "learning_curves.svg"
"""Image of the page on more steps, beside it."""
ROBUSTNESS = "robustness"
"""Name of the chapter on tests under disturbances."""
HEADING = re.compile("^#(?=#)", re.MULTILINE)
"""The first mark of a heading, which a page of its own does not have: its headings are one level higher."""
LOWER = re.compile("^(?=##)", re.MULTILINE)
"""Start of a Markdown heading of level 2 or more, where one more `#` makes it a heading of the next level."""
LONGER = (
    "The tables of which two rows or more have run with this number of steps of the last stage; learning rates are "
    "those chosen at {fewest} steps. Beside the tables at {fewest} steps, and what changes between both: "
    "[The same rows and claims after more steps](training.md). Tests under disturbances: [robustness](robustness.md)."
)
RECORDS = (
    "`machine` is where a run ended: some were begun on another one, a GPU too ([protocol](protocol.md#changes)), and "
    "their minutes are those of both."
)
TRAINED = (
    "Depth and sketch are trained by the same recipe, for some rows again on another machine "
    "([protocol](protocol.md#changes)), so that rows can have other networks in the same seed. Learning rates are "
    "those chosen at the fewest steps. Other tables of the rows with more steps are on pages named `steps_<number>.md`."
)
BESIDE = "Other programs ran on the same machines."
DISTURBANCES = "What each disturbance is: [What breaks a model](../how_to/robustness.md)."
MORE = (
    "Errors, p-values and the same by surface RayIoU: [all claims](claims.md). Tables of the paper: {tables}. Behind "
    "the other columns: [equal budget](equal_budget.md), [more steps](training.md). Behind the reasons: [why a claim "
    "does not hold](reasons.md), [frames 0.1 s apart](interval.md), [seeds that a gap needs](power.md). What it means: "
    "[the tables in words](ablations.md). How it was made: [protocol](protocol.md), [the runs](runs.md)."
)
RULE = (
    "How a claim is decided: [Read the tables](../how_to/read_the_tables.md#when-a-claim-holds). Commands, commits and "
    "machines: [the runs](runs.md)."
)


def chapters(sweep: Sweep, listed: Mapping[str, Sequence[FinishedRun]]) -> dict[str, str]:
    """Return every table of one setting as Markdown under a heading of level 2, by name; the budget is of `listed`."""
    decided = sweep.claims
    papers = {table.name: _of_paper(sweep, table, decided) for table in sweep.tables}
    cost = f"## Budget\n\n{budget.note(listed)}\n\n{markdown(*budget.budget_cells(listed))}"
    limits = f"## {bounds.TITLE}\n\n{bounds.NOTE}\n\n{markdown(*bounds.bounds_cells(sweep.rows))}"
    limits += protocol_text(sweep.rows, bounds.COLUMNS.values())
    found = {"claims": parts_text(verdicts_parts(sweep.tables, sweep.table_rows, decided)), "bounds": limits}
    found |= {table.name: dataset_markdown(table) for table in sweep.datasets}
    tests = robustness_markdown(sweep.robustness) if sweep.robustness else ""
    found |= papers | {"training": training.chapter(sweep), ROBUSTNESS: tests, "budget": cost}
    return {name: text for name, text in found.items() if text}


def longer_chapter(longer: Sweep, fewest: str) -> str:
    """Return the claims of a sweep with more steps than the `fewest`, and its tables without rows that have not run."""
    decided, rows = longer.claims, runs_of_steps(longer)
    shown = [table._replace(rows=[row for row in table.rows if row.run in rows]) for table in longer.tables]
    parts = [parts_text(verdicts_parts(longer.tables, longer.table_rows, decided))]
    parts += [
        _with_claims(as_markdown(ran, rows), table, longer.table_rows, decided)
        for table, ran in zip(longer.tables, shown, strict=True)
        if len(ran.rows) > 1
    ]
    title = f"## The tables at {longer.runs[0].setting[1]} steps\n\n{LONGER.format(fewest=fewest)}\n"
    return "\n".join([title, *(LOWER.sub("#", part) for part in parts)])


def runs_of_steps(sweep: Sweep) -> Rows:
    """Return the runs of all rows that have a sweep's number of steps, on other data too."""
    steps = sweep.runs[0].setting[1]
    return {row: runs for row, runs in sweep.table_rows.items() if runs[0].setting[1] == steps}


def _of_paper(sweep: Sweep, table: PaperTable, decided: Mapping[Name, Judged]) -> str:
    return _with_claims(as_markdown(table, sweep.table_rows), table, sweep.table_rows, decided)


def _with_claims(text: str, table: PaperTable, rows: Rows, decided: Mapping[Name, Judged]) -> str:
    head, claims = claim_cells(table, rows, decided)
    return "\n".join([text, *([markdown(head, claims)] if claims else [])])


def report_markdown(sweep: Sweep) -> str:
    """Return all tables in one text."""
    remarks = " ".join(sweep.remarks) + "\n"
    overview = markdown(*table_of_runs(sweep.runs)) + protocol_text(sweep.rows, overview_keys(sweep.runs))
    return "\n".join([remarks, overview, *chapters(sweep, sweep.rows).values()])


def write_docs(sweeps: Sequence[Sweep], folder: Path) -> list[Path]:
    """Write every table of the first setting as a page of the documentation, `<table>.md`, and return the files.

    Runs with more steps have a page of all their tables, `steps_<number>.md`; those of other presets one together.

    The pages depend on the records of the runs and on the tables alone. Existing pages are overwritten.

    Raises:
        DataError: naming the file that cannot be written.
    """
    sweep, every = documented(sweeps[0]), [run for sweep in sweeps for run in sweep.runs]
    listed = rows_in(sweep.tables, sweep.table_rows)
    pages = {"index": results_page(sweep)}
    for name, text in chapters(sweep._replace(datasets=()), listed).items():
        pages[name] = f"{text}\n{DISTURBANCES if name == ROBUSTNESS else foot(runs_on(name, sweep))}"
    if "training" in pages:
        pages["training"] += f" {TRAINED}\n\n![Validation RayIoU over the steps]({CURVES_IMAGE})"
    pages["budget"] += f" {BESIDE}"
    for steps, longer in list(training.by_steps(sweep).items())[1:]:
        of_tables = [run for runs in runs_of_steps(longer).values() for run in runs]
        pages[f"steps_{steps}"] = f"{longer_chapter(longer, sweep.runs[0].setting[1])}\n{foot(of_tables)}"
    if any(run.row == TRIED_AGAINST for run in every):
        pages["accuracy"] = tried_chapter(every, TRIED_AGAINST)
    of_others = [other.runs for other in sweeps if other.runs[0].setting[0] != sweep.runs[0].setting[0]]
    pages["presets"] = presets_chapter(of_others)
    pages["learning_rates"] = learning_rates(every)
    pages["power"] = power_chapter(sweep.tables, sweep.table_rows, sweep.seed_stds)
    pages["runs"] = f"## Runs\n\n{RECORDS}\n\n{markdown(*records(every))}\n{' '.join(sweep.remarks)}"
    written = []
    for name, text in pages.items():
        if text:
            written.append(folder / f"{name}.md")
            atomic_write(written[-1], f"{GENERATED}\n\n{HEADING.sub('', text).rstrip()}\n")
    return written


def results_page(sweep: Sweep) -> str:
    """Return the page of all results as Markdown; empty without a table of the paper."""
    named = [f"[{NUMERALS[table.number]} {table.title}]({table.name}.md)" for table in of_paper(sweep)]
    lines = [
        "## The paper's claims, at small scale",
        "",
        *results_block(sweep),
        "",
        MORE.format(tables=", ".join(named)),
    ]
    return "\n".join(lines) if named else ""


def results_block(sweep: Sweep) -> list[str]:
    """Return the lines that the page of all results and the README share, with the marks around them."""
    return [BEGIN, *results_lines(sweep), END]


def write_results_into(path: Path, sweep: Sweep) -> None:
    """Write the results into a Markdown file in place of those that it has.

    Raises:
        DataError: naming the file that cannot be read or written.
        UserError: if the file has no place for them.
    """
    lines = text_of(read_bytes(path)).splitlines()
    first = lines.index(BEGIN) if BEGIN in lines else len(lines)
    if END not in lines[first:]:
        raise UserError(f"{path} has no place for the results; add two lines, {BEGIN} and below it {END}")
    lines[first : lines.index(END, first) + 1] = results_block(sweep)
    atomic_write(path, "\n".join([*lines, ""]))


def documented(sweep: Sweep) -> Sweep:
    """Return a sweep, and its longer ones, with what the tables say of the runs of the documentation."""
    tables = [table._replace(note=f"{table.note} {table.here}".strip()) for table in sweep.tables]
    return sweep._replace(tables=tables, longer=[documented(longer) for longer in sweep.longer])


def runs_on(page: str, sweep: Sweep) -> list[FinishedRun]:
    """Return the runs of which a page of the first setting tells."""
    if page == "training":
        of_rows = training.runs_by_row(sweep).values()
        return [run for of_steps in of_rows for runs in of_steps.values() for run in runs]
    own = [table for table in sweep.tables if table.name == page]
    if page == "claims":
        rows = [rows_of_claims(sweep.tables, sweep.table_rows, shared) for shared in (True, False)]
    else:
        rows = [rows_in(own or sweep.tables, sweep.table_rows)]
    return [run for each in rows for runs in each.values() for run in runs]


def foot(runs: Sequence[FinishedRun]) -> str:
    """Return sentences on the runs of a page: their number, seeds, settings, commits and hours."""
    once = {run.name: run for run in runs}.values()
    kinds = {run.setting for run in once}
    settings = [
        f"preset={preset}, {steps} steps, data with the fingerprint {data[:8]}" for preset, steps, data in sorted(kinds)
    ]
    seeds = sorted({str(run.facts.get("seed", "?")) for run in once})
    commits = sorted({str(run.facts.get("commit", "unknown")) for run in once})
    hours = sum(map(budget.minutes_in_all, once)) / 60
    trained = f"{hours:.1f} hours of training (depth and sketch count in every run that uses them)"
    parts = [
        f"{len(once)} runs, seeds {', '.join(seeds)}",
        *settings,
        f"code of commits {', '.join(commits)}",
        trained,
    ]
    return f"{'; '.join(parts)}. {RULE}"


def run_list(sweep: Sweep, folder: Path) -> str:
    """Return a list of the runs: a link from a folder to each, and the command that made it."""
    lines = ["## Runs", ""]
    for run in (run for runs in sweep.rows.values() for run in runs):
        where = path_between(folder, run.folder)
        command = run.command or "command not recorded"
        lines.append(f"- [{run.name}]({where}/) ([config.yaml]({where}/config.yaml)): `{command}`")
    return "\n".join([*lines, ""])


def write_tables(sweep: Sweep, output: Path) -> None:
    """Write `report.md`, and every table as CSV and LaTeX."""
    atomic_write(output / "report.md", f"{report_markdown(sweep)}\n{run_list(sweep, output)}")
    for table in sweep.tables:
        atomic_write(output / f"{table.name}.csv", as_csv(table, sweep.table_rows))
        atomic_write(output / f"{table.name}.tex", as_latex(table, sweep.table_rows))
    for datasets in sweep.datasets:
        atomic_write(output / f"{datasets.name}.csv", dataset_csv(datasets))
        atomic_write(output / f"{datasets.name}.tex", dataset_latex(datasets))
