"""How a row of a table is trained: the overrides of `src/train.py`."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from omniocc.config import own_folders
from omniocc.errors import UserError
from omniocc.io import read_yaml

FOLDER = "ablation"
"""Folder of `conf` with the rows of the paper's tables, a file each."""
TABLES = "sweep"
"""Folder of tables, a file each, in `conf` and in the configuration of other packages."""
STEPS = "preset.stages.occupancy.max_steps"


def table_files(tables: Path) -> list[Path]:
    """Return the files of a folder of tables and of those of the packages in `OMNIOCC_PACKAGES`."""
    folders = [tables, *(own / TABLES for own in own_folders())]
    return [path for folder in folders for path in sorted(folder.glob("*.yaml"))]


def known_rows(conf: Path, tables: Iterable[Path]) -> dict[str, list[str]]:
    """Return the overrides of every row that `conf/ablation` or a table defines, by its name.

    Raises:
        UserError: naming the table that is damaged, or defines a row which is defined otherwise elsewhere.
    """
    known = {path.stem: [f"+{FOLDER}={path.stem}"] for path in sorted((conf / FOLDER).glob("*.yaml"))}
    for path in tables:
        table = read_yaml(path) or {}
        rows = table.get("rows", {}) if isinstance(table, dict) else None
        if not isinstance(rows, dict) or not all(isinstance(row, dict) for row in rows.values()):
            raise UserError(f"{path}: rows has no mapping for every row; see the other tables")
        for key, row in rows.items():
            name = key.partition("@")[0]
            if "overrides" in row and known.setdefault(name, words := _words(table, key, {})) != words:
                raise UserError(f"{path}: row {name} has other overrides elsewhere; give one of both another name")
    return known


def jobs_of(table: Mapping[str, Any], known: Mapping[str, list[str]]) -> list[list[str]]:
    """Return the overrides with which the rows of a table are trained, of each row in turn.

    A row has `overrides` of its own, or else those of the row of its name in `known`. The overrides of the table come
    first and hold for all its rows. `row@3100` is trained for 3,100 steps; `row@same`, for as many as the others.

    Args:
        table: content of `sweeps/<table>.yaml`.
        known: of `known_rows`.

    Raises:
        UserError: naming the row that has no overrides.
    """
    return [_words(table, key, known) for key in table["rows"]]


def _words(table: Mapping[str, Any], key: str, known: Mapping[str, list[str]]) -> list[str]:
    name, _, steps = key.partition("@")
    common, own = table.get("overrides", []), table["rows"][key].get("overrides")
    if own is None and name not in known:
        raise UserError(f"row {name} has no overrides, and neither conf/{FOLDER} nor another table has a row {name}")
    words = [*common, *known[name]] if own is None else [*common, *own, f"name={name}"]
    of_steps = [f"{STEPS}={steps}"] if steps.isdecimal() else []
    return words + [word for word in of_steps if word not in words]
