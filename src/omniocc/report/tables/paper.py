"""Tables of the paper: its figures beside those of the runs here, mean and standard deviation over seeds."""

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from scipy import stats

from omniocc.errors import UserError
from omniocc.report.runs import VOXELS, FinishedRun, read_mapping
from omniocc.report.tables.formats import csv_text, tabular
from omniocc.report.tables.protocol import protocol_lines
from omniocc.run.table import markdown, number

COMPARED = ("parts", "grids", "systems")
"""What the rows of a table may be."""


class PaperRow(NamedTuple):
    """A method of a table.

    Attributes:
        run: its row. `row@same` is a row on other data with as many steps as the others, `row@1000` one of 1,000 steps.
        title: as the table has it.
        paper: the paper's figures by column.
        alone: whether it shares neither depth nor sketch with the other rows of a table of parts.
        claim: in a few words, that the paper's best row of the table is ahead of this one.
    """

    run: str
    title: str
    paper: Mapping[str, float | None]
    alone: bool = False
    claim: str = ""

    def ahead_of(self, other: "PaperRow") -> str:
        """Return the claim that this method is better than another one, in words."""
        return f"{self.title} ahead of {other.title}"


class PaperTable(NamedTuple):
    """A table of the paper, as `sweeps/<table>.yaml` describes it.

    Attributes:
        name: name of the file.
        columns: title of each metric, by key.
        order_by: key of the metric that decides which method is better.
        rows: methods in the paper's order.
        title: of the table on the page of the report.
        note: inconsistencies of the paper's figures.
        here: what holds of the runs of the documentation only; pages of the documentation have it behind the note.
        number: the table's number in the paper.
        compares: `parts` of one system, whose rows share depth and sketch of a seed; `grids`, whose rows share the
            depth alone and are compared as systems; or `systems`.
        claims: pairs of rows, the first ahead of the second: in the paper, or as a claim of one's own where one of them
            has no printed figure. The paper's best row over every other one is always claimed.
        of_lengths: whether every row names its own number of steps, so that the table is the same in every setting.
        steps: number of steps of the runs in the table; empty before `of_steps`.
        reasons: why a claim does not hold or is undecided in the runs of the documentation, by its words there.
    """

    name: str
    title: str
    columns: Mapping[str, str]
    order_by: str
    rows: Sequence[PaperRow]
    note: str = ""
    here: str = ""
    number: int = 0
    compares: str = "parts"
    claims: Sequence[tuple[str, str]] = ()
    of_lengths: bool = False
    steps: str = ""
    reasons: Mapping[str, str] = MappingProxyType({})

    def shares_stages(self, better: PaperRow, other: PaperRow) -> bool:
        """Return whether two rows can use the same depth and sketch networks in a seed."""
        return self.compares == "parts" and not (better.alone or other.alone)

    def shares_depth(self, better: PaperRow, other: PaperRow) -> bool:
        """Return whether two rows can use the same depth network in a seed, with the same sketch or another one."""
        return self.compares != "systems" and not (better.alone or other.alone)

    def printed_gap(self, better: PaperRow, other: PaperRow) -> float:
        """Return the paper's gap between two rows of a claim; nan if the paper has no figure of one of them."""
        return _printed(better, self.order_by) - _printed(other, self.order_by)

    def in_proportion(self, better: PaperRow, other: PaperRow, score: float) -> float:
        """Return the paper's gap where the better row scores as here: printed gap / printed score * score, or nan."""
        return self.printed_gap(better, other) / _printed(better, self.order_by) * score

    def of_steps(self, steps: str) -> "PaperTable":
        """Return the table of runs of a number of steps, in which `@same` is replaced by it."""

        def named(run: str) -> str:
            return run.replace("@same", f"@{steps}")

        rows = [row._replace(run=named(row.run)) for row in self.rows]
        claims = [(named(better), named(other)) for better, other in self.claims]
        return self._replace(rows=rows, claims=claims, steps=steps)


def _printed(row: PaperRow, column: str) -> float:
    figure = row.paper[column]
    return math.nan if figure is None else figure


class Figure(NamedTuple):
    """Mean and sample standard deviation over seeds; the latter is nan for one seed."""

    mean: float
    std: float
    seeds: int


def load_table(path: Path) -> PaperTable:
    """Return the table that a file describes.

    Raises:
        UserError: if a key is missing or has no possible value, or a row has another number of figures than there are
            columns.
    """
    content = read_mapping(path)
    try:
        columns, order_by = content["columns"], content["order_by"]
        rows = [
            PaperRow(run, row["title"], _by_column(columns, row, run), row.get("alone", False), row.get("claim", ""))
            for run, row in content["rows"].items()
        ]
        note, here, number_in_paper = content.get("note", ""), content.get("here", ""), content.get("number", 0)
        compares, claims = content.get("compares", "parts"), [(a, b) for a, b in content.get("claims", ())]
        of_lengths = all("@" in row.run and not row.run.endswith("@same") for row in rows)
        table = PaperTable(
            path.stem, content["title"], columns, order_by, rows, note, here, number_in_paper, compares, claims,
            of_lengths, reasons=dict(content.get("reasons", {})),
        )  # fmt: skip
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path} is not a table of the paper: {error}; see the other files beside it") from error
    _check(table, path)
    return table


def _check(table: PaperTable, path: Path) -> None:
    order_by = table.order_by
    if order_by not in table.columns:
        raise UserError(f"{path}: order_by is {order_by}, which is no column")
    if table.compares not in COMPARED:
        raise UserError(f"{path}: compares is {table.compares}; it is one of {', '.join(COMPARED)}")
    rows = {row.run: row for row in table.rows}
    for better, other in table.claims:
        if gone := [row for row in (better, other) if row not in rows]:
            raise UserError(f"{path}: claims has {better} over {other}, but the table has no row {gone[0]}")
        if better == other or table.printed_gap(rows[better], rows[other]) <= 0:
            raise UserError(f"{path}: claims has {better} over {other}, which is not so in the paper's {order_by}")


def is_table(path: Path) -> bool:
    """Return whether a file of `sweeps/` is a table of methods."""
    return "order_by" in read_mapping(path)


def _by_column(columns: Mapping[str, str], row: Mapping[str, Any], run: str) -> dict[str, float | None]:
    paper = row.get("paper", [None] * len(columns))
    if len(paper) != len(columns):
        raise ValueError(f"row {run} has {len(paper)} figures for {len(columns)} columns")
    return dict(zip(columns, paper, strict=True))


def figure_of(runs: Sequence[FinishedRun], key: str) -> Figure | None:
    """Return mean and standard deviation of a metric over the seeds of a method; None where it was not measured."""
    values = [value for run in runs if (value := run.metrics.get(key)) is not None and not math.isnan(value)]
    if not values:
        return None
    return Figure(statistics.mean(values), statistics.stdev(values) if len(values) > 1 else math.nan, len(values))


def in_cell(key: str, value: float | None) -> str:
    """Return a figure for a table: numbers of voxels abbreviated, everything else with three decimals."""
    if key != VOXELS or value is None or math.isnan(value):
        return number(value)
    return f"{value / 1e6:.2f}M" if value >= 1e5 else f"{value / 1e3:.0f}k"


def rows_of(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> list[tuple[PaperRow, list[Figure | None]]]:
    """Return every row with our figures by column."""
    return [(row, [figure_of(runs.get(row.run, []), key) for key in table.columns]) for row in table.rows]


def as_markdown(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> str:
    """Return two lines for each method, the paper's and ours, and below the order of the methods in both."""
    lines = []
    for row, figures in rows_of(table, runs):
        if has_paper(row):
            lines.append([row.title, "paper", *(in_cell(key, value) for key, value in row.paper.items())])
        lines.append([row.title, source_of(figures), *map(with_spread, table.columns, figures)])
    head = ["method", "", *table.columns.values()]
    parts = [f"## {table.title}", table.note, markdown(head, lines).rstrip(), order_line(table, runs)]
    parts += protocol_lines(runs_of(table, runs), table.columns)
    return "\n\n".join(filter(None, parts)) + "\n"


def runs_of(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> dict[str, Sequence[FinishedRun]]:
    """Return the runs of the rows of a table."""
    return {row.run: runs[row.run] for row in table.rows if row.run in runs}


def has_paper(row: PaperRow) -> bool:
    """Return whether the paper has any figure of this method."""
    return any(value is not None for value in row.paper.values())


def source_of(figures: Sequence[Figure | None]) -> str:
    """Return the number of seeds of our line of a method in words; of some columns it may be smaller."""
    seeds = sorted({figure.seeds for figure in figures if figure is not None})
    if not seeds:
        return "here: not run"
    return f"here, {'-'.join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))} seed{'s' * (seeds[-1] > 1)}"


def order_line(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> str:
    """Return a sentence with the paper's order and ours, and Kendall's tau between them.

    It covers the methods that have both figures. Tau is tau-b, which accounts for equal figures. The sentence is empty
    if the paper has no such table.
    """
    if not any(has_paper(row) for row in table.rows):
        return ""
    both = []
    for row in table.rows:
        figure, paper = figure_of(runs.get(row.run, []), table.order_by), row.paper[table.order_by]
        if figure is not None and paper is not None:
            both.append((row.title, paper, figure.mean))
    if len(both) < 3:
        return "No order to compare: fewer than three methods have run."
    orders = [" > ".join(entry[0] for entry in sorted(both, key=lambda entry: -entry[place])) for place in (1, 2)]
    result: Any = stats.kendalltau([entry[1] for entry in both], [entry[2] for entry in both])
    tau = float(result.statistic)
    agreement = "not defined: all are equal" if math.isnan(tau) else f"{tau:.2f}"
    title = table.columns[table.order_by]
    same = "the same order here" if orders[0] == orders[1] else f"here {orders[1]}"
    return f"By {title}, the paper says {orders[0]}; {same} (Kendall's tau {agreement})."


def as_csv(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> str:
    """Return CSV with a line per method and column."""
    lines = []
    for row, figures in rows_of(table, runs):
        for key, figure in zip(table.columns, figures, strict=True):
            ours = figure or Figure(math.nan, math.nan, 0)
            known = ["" if math.isnan(value) else f"{value:.6g}" for value in ours[:2]]
            paper = row.paper[key]
            lines.append([row.run, row.title, key, "" if paper is None else paper, *known, ours.seeds])
    return csv_text(["row", "method", "metric", "paper", "mean", "standard_deviation", "seeds"], lines)


def as_latex(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> str:
    """Return a LaTeX tabular, the paper's figure in brackets behind ours."""
    lines = []
    for row, figures in rows_of(table, runs):
        cells = []
        for (key, value), figure in zip(row.paper.items(), figures, strict=True):
            ours = with_spread(key, figure).replace("±", r"$\pm$").replace("–", "--")
            cells.append(ours + ("" if value is None else f" ({in_cell(key, value)})"))
        lines.append([_tex(row.title), *cells])
    comment = " ".join([f"{table.title}: here (paper).", *protocol_lines(runs_of(table, runs), table.columns)])
    return tabular(comment, ["method", *map(_tex, table.columns.values())], lines)


def _tex(text: str) -> str:
    return text.replace("&", r"\&").replace("%", r"\%").replace("_", r"\_")


def with_spread(key: str, figure: Figure | None) -> str:
    """Return our figure for a table: mean ± standard deviation over seeds, which numbers of voxels do not have."""
    if figure is None:
        return in_cell(key, None)
    no_std = math.isnan(figure.std) or key == VOXELS
    return in_cell(key, figure.mean) + ("" if no_std else f" ± {figure.std:.3f}")
