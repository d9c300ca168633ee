"""How many seeds a gap of the paper's size needs before it can be found."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from omniocc.errors import UserError
from omniocc.io import read_yaml
from omniocc.report.runs import RAY_IOU
from omniocc.report.tables.claims import LEVEL, Rows, pairs_of, planned_claims, rows_of_claims, title_of
from omniocc.report.tables.formats import csv_text, exact
from omniocc.report.tables.gaps import Gaps
from omniocc.report.tables.paper import PaperRow, PaperTable, figure_of
from omniocc.runs.table import VOXEL_RAYIOU

POWER = 0.8
"""Probability with which a gap of the paper's size is to be found."""
MAX_SEEDS, OTHER_SEEDS = 999, 3
"""Largest number of seeds that is tried, and number of seeds of the rows that a claim is not about."""


class SeedStd(NamedTuple):
    """Standard deviations of RayIoU between seeds.

    Attributes:
        source: where the figures come from.
        parts: of what the effects of row and seed leave, in rows that share earlier stages of a seed.
        systems: of a row that shares no stage with others.
    """

    source: str
    parts: float
    systems: float


class Comparison(NamedTuple):
    """A claim whose number of seeds is asked for.

    Attributes:
        title: the claim in words.
        table: number of its table in the paper, or title.
        key: key of the metric that decides it.
        shares_stages: whether its rows share depth and sketch of a seed.
        paper: the printed gap; nan without one.
        size: the printed gap in proportion to the score here; nan without one, or if the better row has not run.
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


def measure_seed_std(tables: Sequence[PaperTable], rows: Rows, key: str) -> SeedStd | None:
    """Return the standard deviations over the runs; None unless parts and a system have two seeds or more."""
    systems = rows_of_claims(tables, rows, False)
    stds = [figure.std for runs in systems.values() if (figure := figure_of(runs, key)) and figure.seeds > 1]
    parts = Gaps(rows_of_claims(tables, rows, True), key).std
    if math.isnan(parts) or not stds:
        return None
    return SeedStd("the runs here", parts, math.sqrt(sum(std * std for std in stds) / len(stds)))


def planned_comparisons(tables: Sequence[PaperTable], rows: Rows) -> list[Comparison]:
    """Return the claims of all tables, in the metric of their tables, each once, even if its rows have not run."""
    return [_comparison(*claim, rows) for claim in planned_claims(tables, VOXEL_RAYIOU)]


def _comparison(table: PaperTable, better: PaperRow, other: PaperRow, rows: Rows) -> Comparison:
    score = figure_of(rows.get(better.run, ()), table.order_by)
    return Comparison(
        title_of(table, better, other),
        table.short,
        table.order_by,
        table.shares_stages(better, other),
        table.printed_gap(better, other),
        math.nan if score is None else table.in_proportion(better, other, score.mean),
    )


def power_of(size: float, error: float, freedom: int, claims: int) -> float:
    """Return the probability that a two-sided t-test finds a gap of this size, with the right sign.

    Args:
        size: true gap.
        error: standard error of its estimate.
        freedom: degrees of freedom of the error.
        claims: number of claims in the family. The level is that of Holm's first step, the strictest.
    """
    from scipy import stats  # takes a second to import, and only the pages of all results need it

    bound = stats.t.isf(LEVEL / claims / 2, freedom)  # half the level for each sign
    return float(stats.nct.sf(bound, freedom, size / error))


def freedom_of_systems(seeds: int) -> int:
    """Return the degrees of freedom of a gap between two systems."""
    return 2 * seeds - 2


def freedom_of_parts(seeds: int, rows: int) -> int:
    """Return the degrees of freedom of the noise of parts: two rows have these seeds, the others `OTHER_SEEDS`."""
    runs = 2 * seeds + (rows - 2) * OTHER_SEEDS
    seed_effects = max(seeds, OTHER_SEEDS) if rows > 2 else seeds
    return runs - (rows + seed_effects - 1)  # the mean is in the effects of rows and in those of seeds


def seeds_needed(size: float, std: float, freedom: Callable[[int], int], claims: int) -> int | None:
    """Return the smallest number of seeds with which the power is at least `POWER`; None above `MAX_SEEDS`."""

    def enough(seeds: int) -> bool:
        error = std * math.sqrt(2 / seeds)  # of the difference of two means
        return power_of(size, error, freedom(seeds), claims) >= POWER

    low, high = 1, MAX_SEEDS  # fewer than two seeds are never tried
    if not enough(high):
        return None
    while high - low > 1:  # bisection: power grows with the seeds
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def power_csv(tables: Sequence[PaperTable], rows: Rows, given: Sequence[SeedStd]) -> str:
    """Return CSV with the seeds that each claim needs at every standard deviation; empty if there is none.

    Standard deviations are the `given` ones, for claims in RayIoU, and those of the runs here in each claim's own
    metric. A claim without a printed gap has "unknown" seeds, but counts in the family.
    """
    claims, parts = planned_comparisons(tables, rows), _number_of_parts(tables)
    lines = []
    for claim in claims:
        own = measure_seed_std(tables, rows, claim.key)
        for std in [*(given if claim.key == RAY_IOU else ()), *([own] if own else [])]:
            cells = [claim.title, claim.table, exact(claim.paper), exact(claim.size), std.source]
            seeds = _seeds_of_claim(claim, std, parts, len(claims))
            lines.append([*cells, f"{std.parts:.4f}", f"{std.systems:.4f}", str(seeds or f"> {MAX_SEEDS}")])
    head = ["claim", "table", "paper's gap", "paper's gap rescaled", "source of the standard deviations"]
    head += ["standard deviation between seeds, methods that share networks", "standard deviation, other methods"]
    return csv_text([*head, f"seeds that both methods need to find the gap in {POWER:.0%} of cases"], lines)


def _seeds_of_claim(claim: Comparison, std: SeedStd, parts: int, claims: int) -> int | str | None:
    if math.isnan(claim.size):
        return "unknown"
    if claim.shares_stages:
        return seeds_needed(claim.size, std.parts, lambda seeds: freedom_of_parts(seeds, parts), claims)
    return seeds_needed(claim.size, std.systems, freedom_of_systems, claims)


def _number_of_parts(tables: Sequence[PaperTable]) -> int:
    """Return the number of rows over which the noise of parts is estimated: those of claims on the main data."""
    pairs = ((table, pair) for table in tables for pair in pairs_of(table))
    named = {row.run for table, pair in pairs if table.shares_stages(*pair) for row in pair}
    return max(2, len({row for row in named if "@" not in row}))
