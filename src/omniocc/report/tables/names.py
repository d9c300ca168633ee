"""Names of rows for readers."""

from collections import Counter
from collections.abc import Mapping, Sequence

from omniocc.report.tables.paper import PaperTable


def method_names(tables: Sequence[PaperTable]) -> dict[str, str]:
    """Return the name of each row for readers, its title in the first of the paper's tables, or else its shortest one.

    Of rows with the same title all but the first have the row behind it.
    """
    titles: dict[str, str] = {}
    others = [(table.number, len(row.title), row) for table in tables for row in table.rows]
    for *_, row in sorted(others, key=lambda entry: (not entry[0], entry[:2])):
        titles.setdefault(row.run.partition("@")[0], row.title)
    often = Counter(titles.values())
    first = {title: row for row, title in reversed(titles.items())}
    return {
        row: title if often[title] == 1 or first[title] == row else f"{title} ({row})" for row, title in titles.items()
    }


def named(row: str, names: Mapping[str, str]) -> str:
    """Return the name of a row for readers, with its steps where the row has them (`ours@1000`)."""
    plain, at, steps = row.partition("@")
    name = names.get(plain, plain)
    return f"{name.removesuffix(f' ({plain})')}, {int(steps):,} steps" if at else name
