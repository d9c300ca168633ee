"""Tables of poses and of time stamps: text with a line for each, whose columns a header may name.

Without a header the columns have a fixed order. With one its names and units rule: `time`, `#timestamp [ns]`; `frame`;
`file`; `x`, `tx`, `position.x`, `p_RS_R_x [m]`; `qw`, `q_w`, `orientation.w`, `q_RS_w []`; `m00` to `m23` of a matrix,
or `r11` to `r33` beside x, y, z. Columns of other names are not read.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from omniocc.data.formats.files import read_text
from omniocc.data.formats.poses import rigid
from omniocc.errors import LONGEST, DataError, shortened
from omniocc.io import number_of, twice

TimeUnit = Literal["s", "ms", "us", "ns"]
Key = Literal["time", "frame", "file"]
W_FIRST = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Names and order of the numbers of a pose: a position, m, and a unit quaternion."""
W_LAST = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""The order in files of TUM."""

_UNITS: dict[TimeUnit, str] = {
    "s": "s|secs?|seconds?",
    "ms": "ms|msecs?|milliseconds?",
    "us": "us|usecs?|microseconds?",
    "ns": "ns|nsecs?|nanosecs?|nanoseconds?",
}
_UNIT = "|".join(_UNITS.values())
_TIME = rf"(?:time_?stamps?|times?|stamp|ts?)(?:_({_UNIT}))?|(?!.?s$)({_UNIT})"
_BODY = r"(?:\w*pose_)?"  # ROS has field.pose.pose.position.x
_OTHERS = (
    ("frame", r"frame(?:_?(?:id|name|number|index))?|name"),
    ("file", r"(?:file|image)(?:_?(?:name|path))?|path"),
    ("", rf"{_BODY}(?:(?:p|t|pos|position|translation|location)_?(?:rs_r_)?)?([xyz])(?:_m)?"),
    ("q", rf"{_BODY}(?:q|quat|quaternion|rot|rotation|orientation)_?(?:rs_)?([wxyz])"),
    ("m", r"[mrt]_?([0-4])_?([0-4])"),
    ("matrix", "matrix"),  # all numbers from here on
)
"""Meanings of columns and patterns of their names, in lower case, with '_' for signs and spaces."""
_INSTEAD: Mapping[Key, Sequence[str]] = {
    "time": ("time", "frame"),
    "frame": ("frame", "file", "time"),
    "file": ("file", "frame"),
}
"""Columns that serve as a key, of which the first is taken that is there."""


class Row(NamedTuple):
    """A line of a table.

    Attributes:
        where: file and line, for messages.
        keys: the time, or the name of the frame or file.
        pose: as written: the seven numbers of `W_FIRST`, or the 12 or 16 of a matrix, row by row; without a header all
            that follows the keys.
        unit: of the time, as the header states it; None if it does not.
    """

    where: str
    keys: Sequence[str]
    pose: Sequence[str]
    unit: TimeUnit | None


class _Columns(NamedTuple):
    """Where the parts of a line are.

    Attributes:
        keys: places of the keys.
        pose: places of the numbers of a pose, in the order of `Row.pose`; None: all that follows `count` cells.
        count: number of cells of a line.
        unit: of the time; None if it is not stated.
    """

    keys: Sequence[int]
    pose: Sequence[int] | None
    count: int
    unit: TimeUnit | None


def read_table(path: Path, keys: Sequence[Key], order: Sequence[str] = ()) -> list[Row]:
    """Return the lines of a table, whose separators are semicolons, commas, tabs or spaces.

    Lines that begin with `#` are no rows, but the last one before the rows may be the header, as the first line may.

    Args:
        path: the file.
        keys: what its first columns are, where no header says it.
        order: of the numbers of a pose with a quaternion, where no header says it; empty: there are no poses.

    Raises:
        DataError: if the file cannot be read, naming the header that does not say enough, or the line that does not
            have its columns.
    """
    lines = [
        (f"{path}, line {number}", line.strip())
        for number, line in enumerate(read_text(path).splitlines(), start=1)
        if line.strip(" \t;,")
    ]
    rows = [(where, _cells(line, where)) for where, line in lines if not line.startswith("#")]
    for where, cells in rows:
        if (longest := max(map(len, cells))) > LONGEST:
            raise DataError(f"{where}: a cell has {longest:,} characters; it must have at most {LONGEST:,}")
    header = None
    if rows and not any(map(_is_number, rows[0][1])):
        header, *rows = rows
    if not rows:
        return []
    header = header or _commented(lines, len(rows[0][1]))
    columns = _Columns(range(len(keys)), None, len(keys), None) if header is None else _columns(*header, keys, order)
    return [_row(where, cells, columns, order, keys) for where, cells in rows]


def _row(where: str, cells: Sequence[str], columns: _Columns, order: Sequence[str], keys: Sequence[Key]) -> Row:
    count = columns.count
    if len(cells) != count if columns.pose is not None else len(cells) < count:
        raise DataError(f"{where}: it has {len(cells)} cells instead of {count}; is a value missing?")
    pose = cells[count:] if columns.pose is None else [cells[place] for place in columns.pose]
    if order and columns.pose is None and len(pose) == len(order):
        pose = [pose[order.index(name)] for name in W_FIRST]
    return Row(where, [cells[place] for place in columns.keys], pose, columns.unit)


def _cells(line: str, where: str) -> list[str]:
    mark = next((mark for mark in ";,\t" if mark in line), None)
    if mark is None:
        return re.sub(r"\s+(?=[\[(])", "", line).split()  # 'timestamp [ns]' is one name
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=mark, skipinitialspace=True))]
    except csv.Error as error:
        raise DataError(f"{where}: {error}") from error


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _commented(lines: Sequence[tuple[str, str]], count: int) -> tuple[str, list[str]] | None:
    """Return the last comment before the first row that names its `count` columns, and where it is; None without."""
    found = None
    for where, line in takewhile(lambda line: line[1].startswith("#"), lines):
        cells = _cells(line.strip("# "), where)
        known = sum(_meaning(cell)[0] is not None for cell in cells)
        apart = any(mark in line for mark in ";,\t")  # a sentence can have as many words as there are columns
        if known > 4 or (len(cells) == count and (apart or known >= min(3, count))):
            found = where, cells
    return found


def _meaning(cell: str) -> tuple[str | None, str]:
    """Return what the name of a column means, None if that is not known, and the unit that it states."""
    bracket = re.search(r"[\[(](.*)[\])]$", cell)
    unit = bracket[1].strip().lower() if bracket else ""
    name = re.sub(r"\W+", "_", cell[: bracket.start()] if bracket else cell).strip("_").lower()
    if time := re.fullmatch(_TIME, name):
        return "time", unit or time[1] or time[2] or ""
    found = ((meaning, re.fullmatch(pattern, name)) for meaning, pattern in _OTHERS)
    return next((meaning + "".join(match.groups()) for meaning, match in found if match), None), unit


def _columns(where: str, header: Sequence[str], keys: Sequence[Key], order: Sequence[str]) -> _Columns:
    """Return what a header says; raise DataError naming it if a column is missing, doubled or in another unit."""
    meanings, shown = [_meaning(cell) for cell in header], shortened(",".join(header))
    places: dict[str, int] = {}
    for place, (meaning, _) in enumerate(meanings):
        places.setdefault(meaning or "", place)
    chosen = [next((name for name in _INSTEAD[key] if name in places), key) for key in keys]
    pose = _pose_names(places) if order else []
    if missing := [name for name in [*chosen, *pose] if name not in places]:
        raise DataError(
            f"{where}: the header '{shown}' names no column {', '.join(missing)}; give "
            f"{','.join([*keys, *order])}{' or m00,m01 to m23 of a matrix' * bool(order)}, in any order"
        )
    used = [name for name, _ in meanings if name in (*chosen, *pose)]
    if name := twice(name.lower() for name in header if name) or twice(used):
        raise DataError(f"{where}: the header '{shown}' names the column '{name}' twice; keep one")
    units = {name: meanings[places[name]][1] for name in used}
    for name in "xyz":
        if not re.fullmatch("(m|met(er|re)s?)?", units.get(name, "")):
            raise DataError(f"{where}: the column '{header[places[name]]}' is in {units[name]}; positions are in m")
    unit: TimeUnit | None = None
    for known, names in _UNITS.items():
        unit = known if re.fullmatch(names, units.get("time", "")) else unit
    if "time" in chosen and units["time"] and unit is None:
        raise DataError(f"{where}: the time is in {units['time']}; its units are {', '.join(_UNITS)}")
    keyed, posed = [places[name] for name in chosen], [places[name] for name in pose]
    if pose == ["matrix"] or [*keyed, *map(places.get, order)] == list(range(len(header))):
        return _Columns(keyed, None, min(posed, default=len(keys)), unit)
    return _Columns(keyed, posed, len(header), unit)


def _pose_names(places: Mapping[str, int]) -> list[str]:
    """Return the names of the columns that hold a pose, whether they are there or not."""
    if "matrix" in places:
        return ["matrix"]
    cells = [name for name in places if name.startswith("m")]
    if not cells or "qw" in places:
        return list(W_FIRST)
    first = 0 if any("0" in name for name in cells) else 1
    rows = [[f"m{row}{column}" for column in range(first, first + 4)] for row in range(first, first + 4)]
    for row, axis in zip(rows, "xyz", strict=False):
        row[3] = row[3] if row[3] in places else axis
    return [name for row in rows[: 4 if set(rows[3]) <= set(places) else 3] for name in row]


def read_matrices(path: Path, keys: Sequence[Key] = ()) -> tuple[list[Row], Float64[np.ndarray, "F 4 4"]]:
    """Return the lines of a table of 3x4 matrices, and these as poses whose rotations are mended, see `rigid`.

    Raises:
        DataError: naming the line that is no pose.
    """
    rows, matrices = read_table(path, keys, W_FIRST), []
    for row in rows:
        try:
            if len(row.pose) != 12:
                raise ValueError(f"it has {len(row.pose)} numbers of a pose instead of the 12 of a matrix")
            matrices.append(np.reshape([number_of(word) for word in row.pose], (3, 4)))
            rigid(matrices[-1], "the pose")
        except ValueError as error:
            raise DataError(f"{row.where}: {error}") from error
    return rows, rigid(np.reshape(matrices, (-1, 3, 4)), str(path))
