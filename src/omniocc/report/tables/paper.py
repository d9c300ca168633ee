"""Tables of the paper: its figures beside those of the runs here, means over seeds."""

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from omniocc.errors import UserError
from omniocc.report.runs import VOXELS, FinishedRun
from omniocc.report.tables.formats import csv_text, exact, tabular
from omniocc.report.tables.protocol import protocol_lines
from omniocc.runs.renamed import read_mapping
from omniocc.runs.table import Cells, number

COMPARED = ("parts", "grids", "systems")
"""What the rows of a table may be."""
PAPER, PAGES = "paper", ("paper", "systems", "beyond", "appendix/breakdowns")
"""Page of the paper's own tables, and all pages of the documentation that may show a table."""
NUMERALS = ("", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X")
WIDE_COLUMNS = 5
"""A table with more columns than these has a line for each column, so that the paper's figures fit beside ours."""
SPREAD = ["mean", "standard deviation", "standard error", "seeds"]
"""Columns of a figure in CSV."""


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
        page: page of the documentation that shows it; empty if none does.
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
    page: str = ""
    compares: str = "parts"
    claims: Sequence[tuple[str, str]] = ()
    of_lengths: bool = False
    steps: str = ""
    reasons: Mapping[str, str] = MappingProxyType({})

    @property
    def heading(self) -> str:
        """Return the title, behind the number that it has in the paper."""
        return f"Table {NUMERALS[self.number]}: {self.title}" if self.number else self.title

    @property
    def short(self) -> str:
        """Return the number in the paper, or the title of a table that the paper does not have."""
        return f"Table {NUMERALS[self.number]}" if self.number else self.title

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

    @property
    def error(self) -> float:
        """Return the standard error of the mean."""
        return self.std / math.sqrt(self.seeds)


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
        number_in_paper = content.get("number", 0)
        table = PaperTable(
            path.stem,
            content["title"],
            columns,
            order_by,
            rows,
            note=content.get("note", ""),
            here=content.get("here", ""),
            number=number_in_paper,
            page=content.get("page", PAPER if number_in_paper else ""),
            compares=content.get("compares", "parts"),
            claims=[(a, b) for a, b in content.get("claims", ())],
            of_lengths=all("@" in row.run and not row.run.endswith("@same") for row in rows),
            reasons=dict(content.get("reasons", {})),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path} is not a table of the paper: {error}; see the other files beside it") from error
    _check(table, path)
    return table


def _check(table: PaperTable, path: Path) -> None:
    order_by = table.order_by
    if order_by not in table.columns:
        raise UserError(f"{path}: order_by is {order_by}, which is no column")
    if table.page not in ("", *PAGES):
        raise UserError(f"{path}: page is {table.page}; it is one of {', '.join(PAGES)}")
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
    return Figure(statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else math.nan, len(values))


def in_cell(key: str, value: float | None) -> str:
    """Return a figure for a table: numbers of voxels abbreviated, everything else with three decimals."""
    if key != VOXELS or value is None or math.isnan(value):
        return number(value)
    return f"{value / 1e6:.2f}M" if value >= 1e5 else f"{value / 1e3:.0f}k"


def rows_of(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> list[tuple[PaperRow, list[Figure | None]]]:
    """Return every row with our figures by column."""
    return [(row, [figure_of(runs.get(row.run, []), key) for key in table.columns]) for row in table.rows]


def table_cells(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]], errors: bool = True) -> Cells:
    """Return head and a line for each method: the paper's figure, where it has any, and ours, mean ± standard error.

    Tables of many columns, of which the paper has some, have a line for each column instead. Without `errors` ours are
    means alone.
    """
    shown = with_error if errors else mean_alone
    found = rows_of(table, runs)
    papers = [[in_cell(key, value) for key, value in row.paper.items()] for row, _ in found]
    ours = [list(map(shown, table.columns, figures)) for _, figures in found]
    seeds = [str(max((figure.seeds for figure in figures if figure), default=0)) for _, figures in found]
    rows, titles = [row.title for row, _ in found], list(table.columns.values())
    columns: list[tuple[str, list[str]]] = []
    if len(titles) > WIDE_COLUMNS and any(has_paper(row) for row, _ in found):
        for place, (row, _) in enumerate(found):
            columns += [(f"{row.title}, paper", [*papers[place], "–"])] * has_paper(row)
            columns.append((f"{row.title}, here", [*ours[place], seeds[place]]))
        first, names = "Metric", [*titles, "Seeds"]
    else:
        for place, (key, title) in enumerate(table.columns.items()):
            printed = any(row.paper[key] is not None for row, _ in found)
            columns += [(f"{title}, paper", [cells[place] for cells in papers])] * printed
            columns.append((f"{title}, here" if printed else title, [cells[place] for cells in ours]))
        first, names = "Method", rows
        columns.append(("Seeds", seeds))
    lines = zip(names, *(cells for _, cells in columns), strict=True)
    return [first, *(title for title, _ in columns)], [list(line) for line in lines]


def runs_of(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> dict[str, Sequence[FinishedRun]]:
    """Return the runs of the rows of a table."""
    return {row.run: runs[row.run] for row in table.rows if row.run in runs}


def has_paper(row: PaperRow) -> bool:
    """Return whether the paper has any figure of this method."""
    return any(value is not None for value in row.paper.values())


def as_csv(tables: Sequence[tuple[PaperTable, Mapping[str, Sequence[FinishedRun]]]]) -> str:
    """Return CSV with a line for each method and column of a table, which comes with the runs of its rows.

    The same table may follow with runs of more steps, whose rows are told only as far as they have run.
    """
    lines: dict[tuple[str, ...], list[str]] = {}
    for place, (table, runs) in enumerate(tables):
        for row, figures in rows_of(table, runs):
            name, steps = row.run.partition("@")[0], next((run.setting[1] for run in runs.get(row.run, ())), "")
            for (key, title), figure in zip(table.columns.items(), figures, strict=True):
                paper = row.paper[key]
                if figure or (paper is not None and place == 0):
                    known = "" if paper is None else str(paper)
                    cells = [name, row.title, steps, title, key, known, *spread_cells(figure)]
                    lines.setdefault((row.run, steps, key), cells)
    return csv_text(["row", "method", "steps", "metric", "key", "paper", *SPREAD], lines.values())


def spread_cells(figure: Figure | None) -> list[str]:
    """Return the cells below `SPREAD` of a figure; empty ones for what is not known."""
    if figure is None:
        return ["", "", "", "0"]
    return [*map(exact, (figure.mean, figure.std, figure.error)), str(figure.seeds)]


def as_latex(table: PaperTable, runs: Mapping[str, Sequence[FinishedRun]]) -> str:
    """Return a LaTeX tabular of the same cells as `table_cells`."""
    comment = " ".join([f"{table.title}.", *protocol_lines(runs_of(table, runs), table.columns)])
    head, lines = table_cells(table, runs)
    return tabular(comment, list(map(_tex, head)), [list(map(_tex, line)) for line in lines])


def _tex(text: str) -> str:
    for character, latex in {"&": r"\&", "%": r"\%", "_": r"\_", "±": r"$\pm$", "–": "--"}.items():
        text = text.replace(character, latex)
    return text


def with_error(key: str, figure: Figure | None) -> str:
    """Return our figure for a table: mean ± standard error over seeds, which numbers of voxels do not have."""
    if figure is None or math.isnan(figure.std) or key == VOXELS:
        return mean_alone(key, figure)
    return f"{in_cell(key, figure.mean)} ± {figure.error:.3f}"


def mean_alone(key: str, figure: Figure | None) -> str:
    """Return the mean of our figure for a table."""
    return in_cell(key, figure and figure.mean)
