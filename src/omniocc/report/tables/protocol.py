"""How the runs of a table counted their scores, as lines below it."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from omniocc.report.runs import FinishedRun
from omniocc.runs.results import PROTOCOL, says_the_same
from omniocc.runs.table import SCORES, score_of, titled


def protocol_lines(rows: Mapping[str, Sequence[FinishedRun]], keys: Iterable[str]) -> list[str]:
    """Return a line for each kind of score among the keys of a table, and for each way in which it was counted.

    Where rows differ, a line names those that it holds for, or those that it does not.
    """
    return [
        f"{each.score}{'' if each.of_all else f' ({_named(each.rows, rows)})'}: {each.text}."
        for each in counted(rows, keys)
    ]


def protocol_list(rows: Mapping[str, Sequence[FinishedRun]], keys: Iterable[str]) -> list[str]:
    """Return how scores were counted as paragraphs of Markdown for a page: lists of short points."""
    found, ways = [], counted(rows, keys)
    for each in ways:
        # 'mIoU' keeps its small letter
        points = [f"{point if point[1:2].isupper() else titled(point)}." for point in each.text.split("; ")]
        if sum(way.score == each.score for way in ways) > 1:
            points.append(f"These rows: {_named(each.rows, rows)}.")
        elif not each.of_all:
            points.append(f"Not recorded for {len(rows) - len(each.rows)} of {len(rows)} rows.")
        found.append("\n".join([f"**{each.score}**", "", *(f"* {point}" for point in points)]))
    return found


class Counted(NamedTuple):
    """One way in which a score was counted.

    Attributes:
        score: its title.
        rows: the rows that have runs counted so.
        text: the way in words.
        of_all: whether all runs of all rows were counted so.
    """

    score: str
    rows: tuple[str, ...]
    text: str
    of_all: bool


def counted(rows: Mapping[str, Sequence[FinishedRun]], keys: Iterable[str]) -> list[Counted]:
    """Return the ways in which each kind of score among the keys of a table was counted.

    Runs of before this was recorded have none. A text that says more at its end than another holds for both: newer
    runs record more.
    """
    kinds = dict.fromkeys(kind for key in keys if (kind := score_of(key)) is not None)
    found = []
    for kind in (kind for kind in SCORES if kind in kinds):
        texts = {row: [run.facts.get(PROTOCOL, {}).get(kind) for run in runs] for row, runs in rows.items()}
        known = list(filter(None, itertools.chain(*texts.values())))
        rows_by_text: dict[str | None, list[str]] = {}
        for row, of_row in texts.items():
            for text in dict.fromkeys(_fullest(text, known) for text in of_row):
                rows_by_text.setdefault(text, []).append(row)
        of_all = len(rows_by_text) == 1
        found += [Counted(titled(SCORES[kind]), tuple(of), text, of_all) for text, of in rows_by_text.items() if text]
    return found


def _fullest(text: str | None, known: Iterable[str]) -> str | None:
    """Return the longest of the texts that begin with this one and say more after it; itself if none does."""
    return max((more for more in known if more.startswith(f"{text}; ")), key=len, default=text)


def counted_alike(runs: Iterable[FinishedRun], key: str) -> bool:
    """Return whether all runs that tell how they counted the score of a key did so in one way."""
    kind = score_of(key)
    told = {text for run in runs if (text := run.facts.get(PROTOCOL, {}).get(kind)) is not None}
    return all(says_the_same(*pair) for pair in itertools.combinations(told, 2))


def _named(members: Sequence[str], rows: Iterable[str]) -> str:
    """Return the names of some of the rows, or those of the others where these are fewer."""
    others = [row for row in rows if row not in members]
    if len(others) < len(members):
        return f"all rows but {', '.join(others)}" if others else "all rows"
    return ", ".join(members)
