"""How a row of a table is trained: the overrides of `src/train.py`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omniocc.errors import UserError
from omniocc.io import read_yaml

FOLDER = "ablation"
"""Folder of `conf` with the rows of the paper's tables, a file each."""


def options_of(conf: Path) -> dict[str, str]:
    """Return the options of the rows in `conf/ablation`, such as `rivals/fosocc`, by their key `name`."""
    files = sorted((conf / FOLDER).rglob("*.yaml"))
    options = {file: file.relative_to(conf / FOLDER).with_suffix("").as_posix() for file in files}
    return {(read_yaml(file) or {}).get("name", file.stem): option for file, option in options.items()}


def overrides_of(table: Mapping[str, Any], options: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the overrides with which every row of a table is trained, by its name.

    A row has `overrides` of its own, or else is the one of its name in `conf/ablation`. Those of the table come first
    and hold for all. `row@3100` is trained for 3,100 steps; `row@same`, for as many as the others.

    Args:
        table: content of `sweeps/<table>.yaml`.
        options: of `options_of`.

    Raises:
        UserError: naming the row that has neither.
    """
    found = {}
    for key, row in table["rows"].items():
        name, _, steps = key.partition("@")
        own = row.get("overrides")
        if own is None and name not in options:
            raise UserError(f"row {name} has no overrides, and conf/{FOLDER} has no row of this name")
        words: Sequence[str] = [f"+{FOLDER}={options[name]}"] if own is None else [*own, f"name={name}"]
        of_steps = [f"preset.stages.occupancy.max_steps={steps}"] if steps.isdecimal() else []
        found[name] = [*table.get("overrides", ()), *words, *of_steps]
    return found
