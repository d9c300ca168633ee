"""How many seeds a gap of the paper's size needs before it can be found."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from scipy import stats

from omniocc.errors import UserError
from omniocc.io import read_yaml
from omniocc.report.runs import RAY_IOU
from omniocc.report.tables.claims import LEVEL, Rows, pairs_of, planned_claims, rows_of_claims, signed
from omniocc.report.tables.gaps import Gaps
from omniocc.report.tables.paper import PaperRow, PaperTable, figure_of
from omniocc.run.table import Cells, markdown

WANTED = 0.8
"""Probability with which a gap of the paper's size is to be found."""
MOST, OTHERS = 999, 3
"""Most seeds that are tried, and the seeds of the rows that a claim is not about."""
TITLE = "Seeds that a gap of the paper's size needs"


class SeedStd(NamedTuple):
    """Standard deviations of RayIoU between seeds.

    Attributes:
        source: where the figures come from.
        parts: of rows that share the stages of a seed, without the effects of row and seed.
        systems: of a row that shares nothing.
    """

    source: str
    parts: float
    systems: float


class Wanted(NamedTuple):
    """A claim whose power is asked for.

    Attributes:
        title: the claim in words.
        table: title of its table.
        key: of the metric that decides it.
        shares_stages: whether its rows share depth and sketch of a seed.
        paper: the printed gap.
        size: the same in proportion to the score here; nan if the better row has not run.
    """

    title: str
    table: str
    key: str
    shares_stages: bool
    paper: float
    size: float


def load_seed_stds(path: Path) -> list[SeedStd]:
    """Return the standard deviations between seeds of a file such as `sweeps/power.yaml`; none without the file.

    Raises:
        UserError: if an entry lacks a key, or a standard deviation is not above 0.
    """
    if not path.exists():
        return []
    try:
        entries = read_yaml(path)["seed_stds"]
        found = [SeedStd(str(entry["source"]), float(entry["parts"]), float(entry["systems"])) for entry in entries]
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: every entry of seed_stds has source, parts and systems: {error}") from error
    if not all(min(entry.parts, entry.systems) > 0 for entry in found):
        raise UserError(f"{path}: standard deviations must be above 0")
    return found


def seed_std_of(given: Sequence[float]) -> SeedStd:
    """Return the standard deviations that a user gives: of parts, and of systems.

    Raises:
        UserError: for other numbers.
    """
    if len(given) != 2 or min(given) <= 0:
        raise UserError(
            "give two standard deviations above 0: of parts of one system, and of systems alone, such as 0.005 0.015"
        )
    return SeedStd("given", *given)


def measured(tables: Sequence[PaperTable], rows: Rows, key: str) -> SeedStd | None:
    """Return the standard deviations of the runs themselves; None as long as no part, or no system, has two seeds."""
    systems = rows_of_claims(tables, rows, False)
    stds = [figure.std for runs in systems.values() if (figure := figure_of(runs, key)) and figure.seeds > 1]
    parts = Gaps(rows_of_claims(tables, rows, True), key).std
    if math.isnan(parts) or not stds:
        return None
    return SeedStd("the runs here", parts, math.sqrt(sum(std * std for std in stds) / len(stds)))


def wanted(tables: Sequence[PaperTable], rows: Rows) -> list[Wanted]:
    """Return the claims of all tables by the paper's own metric, each once, whether its rows have run or not."""
    return [_wanted(*claim, rows) for claim in planned_claims(tables, "own voxels")]


def _wanted(table: PaperTable, better: PaperRow, other: PaperRow, rows: Rows) -> Wanted:
    score = figure_of(rows.get(better.run, ()), table.order_by)
    return Wanted(
        better.ahead_of(other), table.title, table.order_by, table.shares_stages(better, other),
        table.printed_gap(better, other),
        math.nan if score is None else table.in_proportion(better, other, score.mean),
    )  # fmt: skip


def power_of(size: float, error: float, freedom: int, claims: int) -> float:
    """Return the probability that Student's t finds a gap of a size, with its sign.

    Args:
        size: true gap.
        error: standard error of its estimate.
        freedom: degrees of freedom of the error.
        claims: number of claims in the family. Holm's first step is taken, which is the strictest.
    """
    bound = stats.t.isf(LEVEL / claims / 2, freedom)
    return float(stats.nct.sf(bound, freedom, size / error))


def freedom_of_systems(seeds: int) -> int:
    """Return the degrees of freedom of a gap between two systems."""
    return 2 * seeds - 2


def freedom_of_parts(seeds: int, rows: int) -> int:
    """Return the degrees of freedom of the noise of parts if two rows have these seeds, and the others `OTHERS`."""
    runs = 2 * seeds + (rows - 2) * OTHERS
    return runs - (rows + (max(seeds, OTHERS) if rows > 2 else seeds) - 1)


def seeds_needed(size: float, std: float, freedom: Callable[[int], int], claims: int) -> int | None:
    """Return the smallest number of seeds with which a gap is found in `WANTED` of all cases; None above `MOST`."""

    def enough(seeds: int) -> bool:
        return power_of(size, std * math.sqrt(2 / seeds), freedom(seeds), claims) >= WANTED

    low, high = 1, MOST
    if not enough(high):
        return None
    while high - low > 1:  # power grows with the seeds
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def power_cells(tables: Sequence[PaperTable], rows: Rows, stds: Sequence[Mapping[str, SeedStd]]) -> Cells:
    """Return head and a line for each claim: the paper's gap, and the seeds that it needs at every standard deviation.

    A claim without a printed gap has dashes; it counts in the family.

    Args:
        tables: the paper's tables.
        rows: runs of each row.
        stds: standard deviations by metric; each has that of RayIoU. A dash stands where a claim's metric is lacking.
    """
    claims, parts = wanted(tables, rows), _number_of_parts(tables)
    lines = []
    for claim in claims:
        gaps = signed(claim.paper), signed(claim.size)
        lines.append([claim.title, claim.table, *gaps, *_needed(claim, stds, parts, len(claims))])
    head = [f"std. dev. {entry[RAY_IOU].parts:.4f} / {entry[RAY_IOU].systems:.4f}" for entry in stds]
    return ["claim", "table", "paper", "in proportion", *head], lines


def _needed(claim: Wanted, stds: Sequence[Mapping[str, SeedStd]], parts: int, claims: int) -> Iterator[str]:
    for entry in (by_metric.get(claim.key) for by_metric in stds):
        if entry is None or math.isnan(claim.size):
            yield "–"
            continue
        if claim.shares_stages:
            seeds = seeds_needed(claim.size, entry.parts, lambda n: freedom_of_parts(n, parts), claims)
        else:
            seeds = seeds_needed(claim.size, entry.systems, freedom_of_systems, claims)
        yield f"> {MOST}" if seeds is None else str(seeds)


def _number_of_parts(tables: Sequence[PaperTable]) -> int:
    """Return the number of rows over which the noise of parts is estimated: those of claims on the main data."""
    pairs = ((table, pair) for table in tables for pair in pairs_of(table))
    named = {row.run for table, pair in pairs if table.shares_stages(*pair) for row in pair}
    return max(2, len({row for row in named if "@" not in row}))


def power_chapter(tables: Sequence[PaperTable], rows: Rows, given: Sequence[SeedStd]) -> str:
    """Return the page as Markdown; empty if no standard deviation is given or measured."""
    keys = {claim.key for claim in wanted(tables, rows)}
    here = {key: std for key in sorted(keys) if (std := measured(tables, rows, key)) is not None}
    stds: list[Mapping[str, SeedStd]] = [{RAY_IOU: std} for std in given]
    if RAY_IOU in here:
        stds.append(here)
    if not stds:
        return ""
    head, lines = power_cells(tables, rows, stds)
    parts, claims = _number_of_parts(tables), len(lines)
    sources = [f"* {entry.parts:.4f} / {entry.systems:.4f}: {entry.source}" for entry in given]
    sources += [f"* {entry.parts:.4f} / {entry.systems:.4f}: {entry.source}, `{key}`" for key, entry in here.items()]
    note = (
        f"A claim says that one row scores more than another. The table has the number of trainings, each from "
        f"another seed, that both rows need, so that the claim 'holds' in {WANTED:.0%} of all repetitions if the true "
        f"gap is as large as the paper's, in proportion to the score here; what 'does not hold' needs is not "
        f"computed. Student's t at {LEVEL:.0%} / {claims}, the first and strictest step of Holm's correction for "
        f"{claims} claims; own voxels. Each column is headed by two standard deviations between seeds. The first is "
        f"for rows that use the same trained networks of depth and sketch: what remains without the effects of row "
        f"and seed, known as well as from {parts} rows of {OTHERS} seeds or more. The second is for rows of which "
        f"each trains all of its networks itself, and equal for both, the best case of Welch's test: where they "
        f"differ, it needs more seeds. Those of the runs here are of each claim's own metric, the others of RayIoU. A "
        f"dash: the better row has not run, or the standard deviation of the metric is not known."
    )
    return "\n".join([f"## {TITLE}", "", note, "", *sources, "", markdown(head, lines)])
