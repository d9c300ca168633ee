"""Rows that a user names, compared by whatever has run: gap, error over seeds, p-value and verdict."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from itertools import product
from typing import NamedTuple

from omniocc.errors import UserError, in_line
from omniocc.report.runs import HASH, FinishedRun, grid_name
from omniocc.report.selection import mixtures
from omniocc.report.sweep import Sweep
from omniocc.report.tables.budget import samples_a_step, steps_of_stages
from omniocc.report.tables.claims import JUDGES, LEVEL, p_cell, p_text
from omniocc.report.tables.gaps import RANGE_ERROR, UNKNOWN, Gap, gap_of_systems, holm, paired_gap
from omniocc.report.tables.paper import figure_of
from omniocc.report.tables.protocol import counted_alike

Runs = Sequence[FinishedRun]
NEAREST = 5
"""Most rows that a message names."""
ALIKE: Mapping[str, Callable[[FinishedRun], str]] = {
    "preset": lambda run: run.setting[0],
    "data": lambda run: run.setting[2][:8],
    "steps of depth/sketch/model": lambda run: steps_of_stages(run) if run.facts.get("stages") else run.setting[1],
    "samples a step": samples_a_step,
    "grid": lambda run: grid_name(run.config),
}
"""What two rows should have in common, since a difference in it can make the gap."""


class Pair(NamedTuple):
    """Two rows as the user calls them, with the runs of each in one setting, or in the most similar ones."""

    first: str
    other: str
    runs: tuple[Runs, Runs]

    @property
    def setting(self) -> str:
        """Return the setting of both rows in words; empty if they have none in common."""
        preset, steps, data = self.runs[0][0].setting
        same = self.runs[0][0].setting == self.runs[1][0].setting
        return f"preset={preset}, {steps} steps, data {data[:8]}:" if same else ""

    @property
    def warning(self) -> str:
        """Return a line that names what differs between the rows; empty if nothing does."""
        values = {
            what: [" or ".join(sorted({of(run) for run in runs})) for runs in self.runs] for what, of in ALIKE.items()
        }
        differs = [f"{what} ({first} and {other})" for what, (first, other) in values.items() if first != other]
        apart = "" if self.setting else "have no setting in common: they "
        return f"Warning: {self.first} and {self.other} {apart}differ in {', '.join(differs)}." if differs else ""


def comparison_text(sweeps: Sequence[Sweep], words: Sequence[str]) -> str:
    """Return the comparison of the first row with each other one by both metrics, a line each.

    Two rows are compared in the setting (preset, steps, data) in which both have most seeds, or across settings, with a
    warning. P-values are adjusted by Holm over the pairs, for each metric.

    Args:
        sweeps: runs of all settings.
        words: names of rows, `row@steps`, or titles that tables give them (`omnidepth_occ` is the row `ours`).

    Raises:
        UserError: if a row has no run, or the words are not two different rows or more.
    """
    found = runs_by_name(sweeps)
    rows = {row_called(word, sweeps, found): word for word in words}
    if len(rows) < max(2, len(words)):
        raise UserError(f"--compare needs two rows or more, each once: not {' '.join(words)}")
    (first, name), *others = rows.items()
    pairs = [Pair(name, other, most_alike(found[first], found[row])) for row, other in others]
    lines, setting = [], ""
    for pair, *scores in zip(pairs, *(lines_of(pairs, judge) for judge in JUDGES), strict=True):
        lines += [pair.setting] * (pair.setting != setting) + [pair.warning, *scores]
        setting = pair.setting
    lines += dict.fromkeys(line for pair in pairs for line in mixtures(dict(zip(pair[:2], pair.runs, strict=True))))
    if len(pairs) > 1:
        lines.append(f"In brackets: p adjusted for {len(pairs)} comparisons (Holm), which decides.")
    return "\n".join(filter(None, lines))


def runs_by_name(sweeps: Sequence[Sweep]) -> dict[str, list[Runs]]:
    """Return the runs of every row, those of each setting apart, by `row` and by `row@steps`."""
    found: dict[str, list[Runs]] = {}
    for sweep in sweeps:
        for row, runs in sweep.rows.items():
            for name in (row, f"{row}@{runs[0].setting[1]}"):
                found.setdefault(name, []).append(runs)
    return found


def row_called(word: str, sweeps: Sequence[Sweep], found: Mapping[str, Sequence[Runs]]) -> str:
    """Return the row of a name, or of a title, which stands for the row that the first table calls so.

    Raises:
        UserError: if it has no run; the message names the rows that have, the nearest first.
    """
    titles: dict[str, str] = {}
    for table in sweeps[0].tables:
        for row in table.rows:
            titles.setdefault(_plain(row.title), row.run.removesuffix(f"@{table.steps}"))
    title, at, steps = word.partition("@")
    for row in (word, titles.get(_plain(title), title) + at + steps):
        if row in found:
            return row
    rows = sorted((row for row in found if "@" not in row), key=lambda row: -SequenceMatcher(None, word, row).ratio())
    more = f" and {len(rows) - NEAREST} more" * (len(rows) > NEAREST)
    runs = [run for sweep in sweeps for members in sweep.rows.values() for run in members]
    filed = [run for run in runs if run.same_as and HASH.sub("", run.name) == word]
    if filed:
        raise UserError(f"{filed[0].name} has the configuration of row {filed[0].row}: compare that one")
    raise UserError(
        f"no finished run of row {in_line(word)}; with runs, nearest first: {', '.join(rows[:NEAREST])}{more}"
    )


def _plain(title: str) -> str:
    return re.sub(r"\W+", "_", title.lower()).strip("_")


def most_alike(first: Sequence[Runs], other: Sequence[Runs]) -> tuple[Runs, Runs]:
    """Return the runs of two rows whose settings differ least; of several, those with most seeds, then the first."""

    def unlike(pair: tuple[Runs, Runs]) -> tuple[int, int]:
        settings = (runs[0].setting for runs in pair)
        return sum(one != two for one, two in zip(*settings, strict=True)), -min(map(len, pair))

    return min(product(first, other), key=unlike)


def lines_of(pairs: Sequence[Pair], judge: str) -> Iterator[str]:
    """Yield the line of each pair in one metric."""
    gaps = [gap_of(*pair.runs, f"{JUDGES[judge]}rayiou") for pair in pairs]
    adjusted = holm([gap.p_none for gap, _ in gaps])
    for pair, (gap, seeds), p_value in zip(pairs, gaps, adjusted, strict=True):
        tests = p_cell(gap.p_none, p_value) if len(pairs) > 1 else p_text(gap.p_none)
        measured = f"gap {gap.written} ({seeds})" if seeds else "not compared"
        shown = measured if math.isnan(p_value) else f"{measured}, p {tests}"
        yield f"{judge:<14}  {shown}: {verdict(pair, gap, p_value)}"


def gap_of(first: Runs, other: Runs, key: str) -> tuple[Gap, str]:
    """Return the gap between two rows, and in words the seeds behind it, which are none where it cannot be measured.

    Where two seeds or more of both rows use the same trained depth network, these are compared by the paired t-test,
    all other rows by Welch's.
    """
    figures = figure_of(first, key), figure_of(other, key)
    if figures[0] is None or figures[1] is None or not counted_alike((*first, *other), key):
        return UNKNOWN, ""
    paired = paired_gap(_with_depth(first), _with_depth(other), key)
    if not math.isnan(paired.error):
        return paired, f"{paired.freedom + 1:.0f} seeds of both, paired"
    return gap_of_systems(first, other, key), f"{figures[0].seeds} and {figures[1].seeds} seeds"


def _with_depth(runs: Runs) -> Runs:
    return [run for run in runs if not math.isnan(run.metrics.get(RANGE_ERROR, math.nan))]


def verdict(pair: Pair, gap: Gap, p_value: float) -> str:
    """Return in words which row is ahead, by the adjusted p-value of 'there is no gap'."""
    both = f"{pair.first} and {pair.other}"
    if math.isnan(gap.here):
        return f"{both} have no such score in common, counted by one protocol"
    if math.isnan(gap.error):
        return f"one seed decides nothing between {both}"
    if p_value >= LEVEL:
        return f"undecided between {both}"
    return f"{pair.first} is {'ahead of' if gap.here > 0 else 'behind'} {pair.other}"
