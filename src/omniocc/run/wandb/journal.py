"""Rows of curves written down at once: W&B's own process keeps the last seconds in memory, and a kill takes them."""

import json
import os
from collections.abc import Mapping
from pathlib import Path


class Journal:
    """A file of one line for every row.

    Args:
        path: of the file; made with the first row.
    """

    def __init__(self, path: Path):
        self.path = path

    def read(self) -> list[tuple[int, dict[str, float]]]:
        """Step and figures of every row; a last line that was not finished is cut off."""
        if not self.path.exists():
            return []
        content = self.path.read_bytes()
        whole = content.rfind(b"\n") + 1
        os.truncate(self.path, whole)
        return [(row["step"], row["figures"]) for row in map(json.loads, content[:whole].splitlines())]

    def add(self, step: int, figures: Mapping[str, float]) -> None:
        """Append a row."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a") as file:
            file.write(json.dumps({"step": step, "figures": dict(figures)}) + "\n")
