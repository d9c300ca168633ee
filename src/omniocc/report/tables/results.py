"""Every claim of the paper in one table: printed, here, at equal budget and after more steps."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from omniocc.errors import UserError
from omniocc.report.runs import FinishedRun
from omniocc.report.sweep import Sweep
from omniocc.report.tables.claims import (
    AGAINST,
    HOLDS,
    JUDGES,
    UNDECIDED,
    Judged,
    planned_claims,
    rows_in,
    title_of,
)
from omniocc.report.tables.paper import NUMERALS, PaperTable, figure_of, has_paper
from omniocc.report.tables.training import Planned, by_steps, decided_in
from omniocc.runs.table import VOXEL_RAYIOU, markdown, number

COMMAND = "python src/report.py --runs docs/results/runs.tar.xz --docs docs/results"
"""What writes the documentation's pages of results, and the block in the README."""
EQUAL_BUDGET, DISTANCE = "equal_budget", "distance"
"""The tables of rows with as many steps as all stages of the paper's model have together, and of scores by distance."""
NOT_TESTED, SAME, NOT_RUN = "–", "=", "not run"
KINDS = {"✅": HOLDS, "☑": HOLDS, "❌": AGAINST, "❓": UNDECIDED, NOT_TESTED: NOT_RUN}
"""What each symbol counts as."""
VERBS = {
    HOLDS: ("holds", "hold"),
    AGAINST: ("does not", "do not"),
    UNDECIDED: ("is undecided", "are undecided"),
    NOT_RUN: ("has not run", "have not run"),
}
"""Words for one claim and for several."""
DIFFERENCES = (
    "A re-implementation at small scale. Its data are a virtual world, not CARLA. It has an eighth of the "
    "paper's voxels and trains the occupancy stage for 2.8 epochs, not 40."
)
LEGEND = (
    "✅ holds on both metrics. ☑ holds on the paper's metric only. ❌ is refuted on the paper's metric: the sign is "
    "opposite, or a gain of the paper's size is excluded. ❓ is undecided, with too few seeds. "
    f"{NOT_TESTED} has not run or was not tested. {SAME} marks methods with equal numbers of steps."
)
REMARKS = (
    "Metrics: voxel RayIoU (`test/rayiou`) is the paper's. Surface RayIoU (`test/lidar/rayiou`) casts rays to the true "
    "surfaces.",
    "Numbers: the gap in voxel RayIoU, and in brackets the mean scores of both methods. Methods that use the same "
    "depth network are compared within seeds, so a gap can differ from these scores in the last digit.",
    "Equal budget: methods without stages of depth and sketch train for as many steps as all stages of OmniDepth-Occ "
    "together. BEVDet also learns from true ranges.",
)
WHY = "Why claims do not hold here, or stay undecided:"
AGAIN = f"`{COMMAND}` writes this again from the records of the runs, without training."


class Verdict(NamedTuple):
    """A claim as both metrics decide it; None where it was not tested."""

    voxels: Judged | None = None
    surface: Judged | None = None

    @property
    def symbol(self) -> str:
        """Return the symbol of the verdict by voxel RayIoU; where the claim holds, also whether by surface RayIoU."""
        if self.voxels is None:
            return NOT_TESTED
        if self.voxels.verdict == HOLDS:
            return "✅" if self.surface is not None and self.surface.verdict == HOLDS else "☑"
        return "❌" if self.voxels.verdict.startswith(AGAINST) else "❓"

    @property
    def gap(self) -> str:
        """Return the gap in voxel RayIoU for a table."""
        return NOT_TESTED if self.voxels is None else f"{self.voxels.claim.gap.here:+.3f}"

    @property
    def cell(self) -> str:
        """Return symbol and gap for a table."""
        return NOT_TESTED if self.voxels is None else f"{self.symbol} {self.gap}"


def results_lines(sweep: Sweep) -> list[str]:
    """Return headline, two tables and the meaning of symbols as lines of Markdown, which any file can hold.

    They are empty if no table is the paper's.
    """
    claims = planned_claims(of_paper(sweep), VOXEL_RAYIOU)
    if not claims:
        return []
    longest = _longest(sweep)
    here, *after = [verdicts_in(each, of_paper(each), claims) for each in (sweep, *longest)]
    head = ["Table", "Claim", "Paper", "Here", "Verdict", "Equal budget", *(_times(sweep, each) for each in longest)]
    lines = [
        [*cells, *(verdict.cell for verdict in rest)]
        for cells, *rest in zip(_first_cells(sweep, claims, here), *after, strict=True)
    ]
    told = [headline(here), DIFFERENCES, f"`preset={sweep.runs[0].setting[0]}`, {_training(sweep)}."]
    parts = [" ".join(told), markdown(head, lines), distance_text(sweep), LEGEND]
    return "\n\n".join(part.strip() for part in parts if part).splitlines()


def remark_lines(sweep: Sweep) -> list[str]:
    """Return what the numbers are, the counts after more steps, and why claims do not hold, as a list in Markdown.

    Raises:
        UserError: if a table gives the reason of something that it does not claim.
    """
    claims = planned_claims(of_paper(sweep), VOXEL_RAYIOU)
    here, *after = [verdicts_in(each, of_paper(each), claims) for each in (sweep, *_longest(sweep))]
    more = [
        f"* {_times(sweep, each)}: {_training(each)}. {_sentence(counted(found))}"
        for each, found in zip(_longest(sweep), after, strict=True)
    ]
    return [*(f"* {line}" for line in REMARKS), *more, *reason_lines(claims, here), f"* {AGAIN}"]


def _longest(sweep: Sweep) -> list[Sweep]:
    """Return the runs with most steps, if they have more than those of the sweep."""
    return list(by_steps(sweep).values())[1:][-1:]


def of_paper(sweep: Sweep) -> list[PaperTable]:
    """Return the tables of a sweep that have a number in the paper."""
    return [table for table in sweep.tables if table.number]


def verdicts_in(sweep: Sweep, tables: Sequence[PaperTable], claims: Sequence[Planned]) -> list[Verdict]:
    """Return how tables of a sweep decide each of the claims, which may be those of a sweep with other steps."""
    return [
        Verdict(*found) for found in zip(*(decided_in(sweep, tables, claims, judge) for judge in JUDGES), strict=True)
    ]


def _first_cells(sweep: Sweep, claims: Sequence[Planned], here: Sequence[Verdict]) -> Iterator[list[str]]:
    """Yield the cells of each claim up to that at equal budget."""
    tables = [table for table in sweep.tables if table.name == EQUAL_BUDGET]
    for claim, verdict, equal in zip(claims, here, verdicts_in(sweep, tables, claims), strict=True):
        table, *pair = claim
        runs = [sweep.table_rows.get(row.run, ()) for row in pair]
        figures = [figure_of(each, table.order_by) for each in runs]
        printed = _sizes(f"{table.printed_gap(*pair):+.3f}", [row.paper[table.order_by] for row in pair])
        scores = [figure and figure.mean for figure in figures]
        measured = NOT_TESTED if verdict.voxels is None else _sizes(verdict.gap, scores)
        budget = SAME if _as_many_steps(*runs) else equal.cell
        yield [NUMERALS[table.number], title_of(*claim), printed, measured, verdict.symbol, budget]


def _sizes(gap: str, scores: Iterable[float | None]) -> str:
    return f"{gap} ({' / '.join(map(number, scores))})"


def _as_many_steps(*rows: Sequence[FinishedRun]) -> bool:
    """Return whether all runs of all rows have as many steps in their stages together."""
    totals = {sum(run.facts.get("stages", {}).values()) for runs in rows for run in runs}
    return all(rows) and len(totals) == 1 and 0 not in totals


def _training(sweep: Sweep) -> str:
    """Return the steps of a sweep, and how many seeds its rows in the paper's tables have, in words."""
    rows = rows_in(of_paper(sweep), sweep.table_rows)
    seeds = sorted({len(runs) for runs in rows.values()})
    ends = " to ".join(map(str, dict.fromkeys((seeds[0], seeds[-1])))) if seeds else "no"
    return f"{_in_thousands(sweep.runs[0].setting[1])} of occupancy training, {ends} seed{'s' * (ends != '1')}"


def _sentence(counts: Sequence[str]) -> str:
    """Return counts of claims in words as a sentence."""
    first, *others = counts
    number, _, verb = first.partition(" ")
    return ", ".join([f"{number} {'claim' if number == '1' else 'claims'} {verb}", *others]) + "."


def _in_thousands(steps: str) -> str:
    return f"{int(steps):,} steps" if steps.isdigit() else f"{steps} steps"


def _times(sweep: Sweep, longer: Sweep) -> str:
    """Return the steps of a longer sweep as a multiple of those of a sweep; as they are if the latter are no number."""
    fewest, most = sweep.runs[0].setting[1], longer.runs[0].setting[1]
    return f"{int(most) / int(fewest):.3g}x steps" if fewest.isdigit() else _in_thousands(most)


def headline(verdicts: Sequence[Verdict]) -> str:
    """Return how many of the paper's claims hold, as a sentence in bold."""
    first, *others = counted(verdicts)
    holding, verb = first.split(" ")
    return ", ".join([f"**{holding} of the paper's {len(verdicts)} claims {verb} here", *others]) + ".**"


def counted(verdicts: Iterable[Verdict]) -> list[str]:
    """Return in words how many claims hold, and how many do not, are undecided or have not run, if any."""
    numbers = Counter(KINDS[verdict.symbol] for verdict in verdicts)
    return [
        f"{numbers[kind]} {one if numbers[kind] == 1 else several}"
        for kind, (one, several) in VERBS.items()
        if numbers[kind] or kind == HOLDS
    ]


def distance_text(sweep: Sweep) -> str:
    """Return scores by distance, the paper's beside ours, as a Markdown table; empty without such a table."""
    for table in (table for table in of_paper(sweep) if table.name == DISTANCE):
        head = [f"RayIoU by distance (Table {NUMERALS[table.number]})"]
        head += [f"{band}, {source}" for band in table.columns.values() for source in ("paper", "here")]
        lines = []
        for row in filter(has_paper, table.rows):
            figures = [figure_of(sweep.table_rows.get(row.run, ()), key) for key in table.columns]
            pairs = zip(row.paper.values(), (figure and figure.mean for figure in figures), strict=True)
            lines.append([row.title, *(number(value) for pair in pairs for value in pair)])
        return markdown(head, lines)
    return ""


def reason_lines(claims: Sequence[Planned], here: Sequence[Verdict]) -> list[str]:
    """Return why claims do not hold or are undecided: a list of the reasons that the tables give.

    Raises:
        UserError: if a table gives the reason of something that it does not claim.
    """
    verdicts = {title_of(*claim): KINDS[verdict.symbol] for claim, verdict in zip(claims, here, strict=True)}
    titles: dict[str, list[str]] = {}
    for table in {table.name: table for table, *_ in claims}.values():
        for title, reason in table.reasons.items():
            if title not in verdicts:
                own = ", ".join(title_of(*claim) for claim in claims if claim[0] is table)
                raise UserError(f"table {table.name}: reasons has {title!r}, which it does not claim; it claims {own}")
            if verdicts[title] in (AGAINST, UNDECIDED):
                titles.setdefault(reason, []).append(title)
    return [f"* {WHY}", *(f"  * {'; '.join(of)}: {reason}" for reason, of in titles.items())] if titles else []
