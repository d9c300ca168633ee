"""Recordings of the Rerun viewer, read back."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rerun.chunk import RrdReader


class Logged(NamedTuple):
    """What was logged at one path in one frame; `frame` is None for what holds in all frames."""

    frame: int | None
    columns: dict[str, Any]

    def array(self, name: str) -> np.ndarray:
        """Return a component as an array."""
        return np.array(self.columns[name])


def read(path: Path) -> dict[str, list[Logged]]:
    """Return everything in a recording by its path, in the order of frames."""
    found: dict[str, list[Logged]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        kept = [name for name in batch.schema.names if name not in ("log_time", "log_tick")]
        for row in batch.select(kept).to_pylist():
            columns = {name: value for name, value in row.items() if value is not None}
            found.setdefault(chunk.entity_path, []).append(Logged(columns.get("frame"), columns))
    return {name: sorted(rows, key=lambda row: -1 if row.frame is None else row.frame) for name, rows in found.items()}


def below(found: dict[str, list[Logged]], path: str, frame: int) -> dict[str, Logged]:
    """Return what was logged in a frame below a path, without what was cleared, by the rest of its path."""
    return {
        name.removeprefix(f"{path}/"): row
        for name, rows in found.items()
        if name.startswith(f"{path}/")
        for row in rows
        if row.frame == frame and not any("Clear" in column for column in row.columns)
    }
