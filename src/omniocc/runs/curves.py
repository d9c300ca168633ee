"""Curves of training and validation, read from the CSV files that every run writes."""

import csv
import io
import math
import os
import re
from pathlib import Path

from omniocc.errors import UserError, repr_of
from omniocc.io import read_bytes, text_of

CURVES = "csv/version_*/metrics.csv"
"""Files of logged metrics in the folder of a run, one for each start."""
Curve = dict[int, float]
"""Values of a metric by optimizer step."""


def read_curve(folder: Path, key: str) -> Curve:
    """Return the values of one logged metric; see `read_curves`."""
    return read_curves(folder).get(key, {})


def read_curves(folder: Path) -> dict[str, Curve]:
    """Return the values of all logged metrics by key; those that are not finite are left out.

    A resumed run has one file for each start; where they overlap, the later file is used, since the run continued from
    an earlier checkpoint. A line that is being written is left out. Without CSV files in the run's folder the result is
    empty.
    """
    curves: dict[str, Curve] = {}
    for path in curve_files(folder):
        rows = read_rows(path)
        began = min((int(row["step"]) for row in rows), default=math.inf)
        curves = {key: {step: value for step, value in curve.items() if step < began} for key, curve in curves.items()}
        for row in rows:
            step = int(row.pop("step"))
            for key, value in row.items():
                if value and math.isfinite(number := _number(path, key, value)):
                    curves.setdefault(key, {})[step] = number
    return {key: curve for key, curve in curves.items() if curve}


def curve_files(folder: Path) -> list[Path]:
    """Return the CSV files of a run in the order of its starts; copies in folders of other names are left out."""
    starts = {path: path.name.removeprefix("version_") for path in folder.glob(f"{Path(CURVES).parent}")}
    found = [path for path, start in starts.items() if start.isdecimal() and os.path.lexists(path / Path(CURVES).name)]
    return [path / Path(CURVES).name for path in sorted(found, key=lambda path: int(starts[path]))]


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the complete lines of a CSV file that have a step, as texts by key."""
    content = read_bytes(path)
    try:
        whole, end, _ = text_of(content).rpartition("\n")
        head, *lines = [*csv.reader(io.StringIO(whole + end, newline=""))] or [[]]
    except (ValueError, csv.Error) as error:
        raise UserError(f"{path} is damaged: {error}") from error
    rows = [dict(zip(head, line, strict=True)) for line in lines if len(line) == len(head)]
    return [row for row in rows if re.fullmatch(r"[0-9]{1,15}", row.get("step", ""))]


def _number(path: Path, key: str, value: str) -> float:
    try:
        return float(value)
    except ValueError as error:
        raise UserError(f"{path} is damaged: {key} is {repr_of(value)}") from error
