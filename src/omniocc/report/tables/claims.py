"""The paper's claims that one method is ahead of another, decided by one rule: see `Judged.verdict`."""

import functools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from omniocc.report.runs import RAY_IOU, FinishedRun
from omniocc.report.tables.gaps import EXACT, UNKNOWN, Gap, Gaps, gap_of_systems, holm, paired_gap
from omniocc.report.tables.paper import PaperRow, PaperTable, figure_of
from omniocc.report.tables.protocol import counted_alike
from omniocc.runs.scenes import LIDAR, RAYS, SCENES, without_each_scene
from omniocc.runs.table import SURFACE_RAYIOU, VOXEL_RAYIOU

KINDS = {"test/rayiou": RAYS, "test/lidar/rayiou": LIDAR}
"""Rays whose counts give a metric, by its key."""


def error_over_streets(better: Sequence[FinishedRun], other: Sequence[FinishedRun], key: str) -> float:
    """Return the standard error of a gap over the streets of the test, for the seeds that were trained.

    It is that of the jackknife: every street is left out of both rows in turn (Efron and Stein, 'The jackknife estimate
    of variance', Annals of Statistics 9, 1981). It is nan if a run has no counts by street, if the rows have other
    streets, or for another metric than RayIoU.
    """
    if key not in KINDS:
        return math.nan
    scores = [_without_each(run.folder / SCENES, KINDS[key]) for run in (*better, *other)]
    streets = sorted(scores[0]) if scores else []
    if len(streets) < 2 or any(sorted(found) != streets for found in scores):
        return math.nan
    values = np.array([[found[street] for street in streets] for found in scores])
    gaps = values[: len(better)].mean(axis=0) - values[len(better) :].mean(axis=0)
    return float(math.sqrt((len(streets) - 1) * gaps.var()))


def _without_each(path: Path, kind: str) -> Mapping[str, float]:
    return _read(path, path.stat().st_mtime_ns, kind) if path.exists() else {}


@functools.cache
def _read(path: Path, modified_ns: int, kind: str) -> Mapping[str, float]:
    """Return the scores without each street of a file as it is since `modified_ns`."""
    return without_each_scene(path.parent, kind)


Rows = Mapping[str, Sequence[FinishedRun]]
LEVEL = 0.05
"""Largest probability in a family of a wrong 'holds' or 'opposite sign', and of a wrong 'smaller'."""
JUDGES = {VOXEL_RAYIOU: "test/", SURFACE_RAYIOU: "test/lidar/"}
"""Beginning of the keys of the scores of each of the two metrics."""
HOLDS, AGAINST, UNDECIDED = "holds", "does not hold", "undecided"

Name = tuple[tuple[str, ...], tuple[str, ...], str]
"""What makes two claims of different tables the same: the runs of both rows, and the metric."""


class Claim(NamedTuple):
    """A gap of the paper, and the same here in one metric.

    Attributes:
        paper: the printed gap, above 0; nan in a claim of one's own, about a row without a printed figure.
        size: the printed gap in proportion to the better row's score here: printed gap / printed score * score here.
        gap: as it is measured here.
        streets: standard error of the gap over the streets of the test, without that over seeds; nan if unknown.
    """

    paper: float
    size: float
    gap: Gap
    streets: float = math.nan

    @property
    def p_size(self) -> float:
        """Return the one-sided p-value of 'the gap is as large as the paper's, in proportion, or larger', or nan."""
        here, error, freedom = self.gap
        if math.isnan(self.size):
            return math.nan
        if error < EXACT:
            return float(here > self.size - EXACT)
        return float(stdtr(freedom, (here - self.size) / error))


class Judged(NamedTuple):
    """A claim, and both of its p-values adjusted by Holm over the family of one metric."""

    claim: Claim
    none: float
    size: float

    @property
    def verdict(self) -> str:
        """Return whether the claim holds.

        It holds if 'there is no gap' is rejected and the gap has the paper's sign. It does not hold if 'there is no
        gap' is rejected and the gap has the other sign, or, 'smaller', if 'the gap is as large as the paper's' is
        rejected while 'there is no gap' is not. Otherwise it is undecided. Without a printed gap nothing is 'smaller'.
        """
        here, error, _ = self.claim.gap
        if math.isnan(error):
            return f"{UNDECIDED} (one seed only)"
        if self.none < LEVEL:
            return HOLDS if here > 0 else f"{AGAINST} (opposite sign)"
        return f"{AGAINST} (smaller)" if self.size < LEVEL else UNDECIDED


def metric_of(table: PaperTable, judge: str) -> str | None:
    """Return the key of a metric's scores in which the claims of a table are decided; None if it has none."""
    if judge == VOXEL_RAYIOU:
        return table.order_by
    return table.order_by.replace("test/", JUDGES[judge], 1) if table.order_by.startswith("test/rayiou") else None


def title_of(table: PaperTable, better: PaperRow, other: PaperRow) -> str:
    """Return a claim in the words of its table, or else with both methods, and the band of distance if it has one."""
    if other.claim and (better.run, other.run) not in table.claims:
        return other.claim
    band = "" if table.order_by == RAY_IOU else f", {table.columns[table.order_by]}"
    return f"{better.title} ahead of {other.title}{band}"


def pairs_of(table: PaperTable) -> Iterator[tuple[PaperRow, PaperRow]]:
    """Yield the rows of each claim of a table, the better one first.

    Claimed are the paper's best row over every other one, and what the table's `claims` add.
    """
    rows = {row.run: row for row in table.rows}
    printed = [row for row in table.rows if row.paper[table.order_by] is not None]
    ranked = sorted(printed, key=lambda row: -(row.paper[table.order_by] or 0.0))
    yield from ((ranked[0], row) for row in printed if row is not ranked[0])
    yield from ((rows[better], rows[other]) for better, other in table.claims)


def claims_in(tables: Sequence[PaperTable]) -> list[tuple[PaperTable, PaperRow, PaperRow]]:
    """Return the claims of all tables, those with a printed gap first: where one stands twice, that gap counts."""
    claims = [(table, *pair) for table in tables for pair in pairs_of(table)]
    return sorted(claims, key=lambda claim: math.isnan(claim[0].printed_gap(*claim[1:])))


def rows_in(tables: Sequence[PaperTable], rows: Rows) -> Rows:
    """Return the rows of tables that have run; one that has two names, as `ours` and `ours@1000`, counts once."""
    return _once((row.run for table in tables for row in table.rows), rows)


def rows_of_claims(tables: Sequence[PaperTable], rows: Rows, share_stages: bool) -> Rows:
    """Return the rows of claims that have run, of those about two rows that share stages, or of the others."""
    claims = ((table, pair) for table, *pair in claims_in(tables))
    return _once(
        (row.run for table, pair in claims if table.shares_stages(*pair) == share_stages for row in pair), rows
    )


def planned_claims(tables: Sequence[PaperTable], judge: str) -> list[tuple[PaperTable, PaperRow, PaperRow]]:
    """Return the claims that a metric decides, each once, in its first table, whether its rows have run or not."""
    names, found = names_in(tables), {}
    for table, better, other in claims_in(tables):
        if (key := metric_of(table, judge)) is not None:
            found.setdefault((names[better.run], names[other.run], key), (table, better, other))
    return list(found.values())


def _once(names: Iterable[str], rows: Rows) -> Rows:
    found: dict[str, Sequence[FinishedRun]] = {}
    for name in names:
        if name in rows and not any(runs is rows[name] for runs in found.values()):
            found[name] = rows[name]
    return found


def names_in(tables: Sequence[PaperTable]) -> dict[str, str]:
    """Return the rows of tables with their names.

    In runs of 1,000 steps the name of `ours@1000` is `ours`, if a table has that row too.
    """
    rows = {row.run: table.steps for table in tables for row in table.rows}
    plain = {row: row.removesuffix(f"@{steps}") for row, steps in rows.items()}
    return {row: plain[row] if plain[row] in rows else row for row in rows}


def claims_of(tables: Sequence[PaperTable], rows: Rows, judge: str, paired: bool = False) -> dict[Name, Claim]:
    """Return the claims of all tables whose two rows have run, each once.

    The noise of rows that share stages is estimated over all such rows of claims, that of others over both rows. If
    `paired`, rows that share the depth network are compared on the seeds that both have, with the noise of these alone.
    Rows of which no seed has the same depth network are compared as systems.
    """
    found: dict[Name, Claim] = {}
    keys = {key for table in tables if (key := metric_of(table, judge)) is not None}
    noise = {key: None if paired else Gaps(rows_of_claims(tables, rows, True), key) for key in keys}
    for table, better, other in claims_in(tables):
        key = metric_of(table, judge)
        name = name_of(better, other, rows, key)
        if name is not None and key is not None:
            found.setdefault(name, _claim(table, better, other, rows, key, noise[key]))
    return found


def name_of(better: PaperRow, other: PaperRow, rows: Rows, key: str | None) -> Name | None:
    """Return the name of the claim about two rows in a metric.

    It is None without a metric, or a figure of one of them, and where they counted it by different protocols.
    """
    runs = rows.get(better.run, ()), rows.get(other.run, ())
    if key is None or figure_of(runs[0], key) is None or figure_of(runs[1], key) is None:
        return None
    if not counted_alike((*runs[0], *runs[1]), key):
        return None
    return tuple(run.name for run in runs[0]), tuple(run.name for run in runs[1]), key


def _claim(table: PaperTable, better: PaperRow, other: PaperRow, rows: Rows, key: str, noise: Gaps | None) -> Claim:
    score = figure_of(rows[better.run], key)
    assert score is not None
    gap = gap_by_seed(table, better, other, rows, key, noise)
    if math.isnan(gap.here):
        gap = gap_of_systems(rows[better.run], rows[other.run], key)
    streets = error_over_streets(rows[better.run], rows[other.run], key)
    size = table.in_proportion(better, other, score.mean)
    return Claim(table.printed_gap(better, other), size, gap, streets)


def gap_by_seed(
    table: PaperTable, better: PaperRow, other: PaperRow, rows: Rows, key: str, noise: Gaps | None = None
) -> Gap:
    """Return the gap between two rows over the seeds in which they use the same networks; unknown without such a seed.

    With `noise`, these are depth and sketch, and the standard error is that of `noise`. Without, it is the depth
    network, and a paired t-test.
    """
    if noise is None:
        shares = table.shares_depth(better, other)
        return paired_gap(rows[better.run], rows[other.run], key) if shares else UNKNOWN
    if not table.shares_stages(better, other):
        return UNKNOWN
    return noise.between(_as_in(noise, better.run, rows), _as_in(noise, other.run, rows))


def _as_in(noise: Gaps, row: str, rows: Rows) -> str:
    """Return the name under which the runs of a row are counted."""
    return row if noise.has(row) else next(name for name, runs in rows.items() if runs is rows[row] and noise.has(name))


def verdicts_of(tables: Sequence[PaperTable], rows: Rows, paired: bool = False) -> dict[Name, Judged]:
    """Return all claims by both metrics with their adjusted p-values; `paired` as in `claims_of`.

    The tables of the documentation are a family together, each other table is one of its own: a table that a user adds
    changes no verdict on the paper. The family of a metric has every claim of its tables once, though it may stand in
    several, and also those whose rows have not run yet, which count as not rejected.
    """
    found: dict[Name, Judged] = {}
    for family in ([table for table in tables if table.page], *([table] for table in tables if not table.page)):
        found = _judged_in(family, rows, paired) | found
    return found


def _judged_in(tables: Sequence[PaperTable], rows: Rows, paired: bool) -> dict[Name, Judged]:
    found: dict[Name, Judged] = {}
    for judge in JUDGES:
        claims = claims_of(tables, rows, judge, paired)
        planned = planned_claims(tables, judge)
        none = holm([claim.gap.p_none for claim in claims.values()], len(planned))
        printed = [claim for claim in planned if not math.isnan(claim[0].printed_gap(*claim[1:]))]
        size = holm([claim.p_size for claim in claims.values()], len(printed))
        found |= {
            name: Judged(*each)
            for name, each in zip(claims, zip(claims.values(), none, size, strict=True), strict=True)
        }
    return found


def signed(gap: float) -> str:
    """Return a gap for a table; a dash where there is none."""
    return "–" if math.isnan(gap) else f"{gap:+.3f}"


def p_cell(p_value: float, adjusted: float) -> str:
    """Return a p-value and its adjusted one for a table."""
    if math.isnan(adjusted):
        return "–"
    return f"{p_text(p_value)} ({p_text(adjusted)})"


def p_text(p_value: float) -> str:
    """Return a p-value for a table, with two digits that count."""
    return "<0.0001" if p_value < 1e-4 else f"{p_value:.2g}" if p_value < 1 else "1"
