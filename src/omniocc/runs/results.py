"""The results of one run: metrics.json, table.md and the same table on the screen."""

import json
import math
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from omniocc.bounds import fits
from omniocc.errors import UserError, first_line, repr_of
from omniocc.io import atomic_write, parse_json, read_short_text
from omniocc.progress import Status, write_status
from omniocc.runs.table import ORIGINS, as_markdown, as_text

METRICS, IMAGES = "metrics.json", "images"
"""File with the figures of a run, which marks it as finished, and folder of the sheets that it draws."""
CANDIDATES = "fraction of candidates"
"""Fact of runs whose sketch is no stage: the fraction of candidates among all voxels."""
MINUTES = "minutes of training"
"""Fact of runs and stages: the time of their training, that before a stop included."""
EARLIER_MINUTES = "minutes of earlier stages"
"""Fact of runs: the time of the trainings of depth and sketch, which other runs may share."""
FINISHED = "finished"
"""Fact of runs: when their test ended, in UTC, as text whose order is that of time."""

PROTOCOL = "protocol"
"""Fact of runs: how each kind of score was counted (rays, origins, thresholds, masks, classes), one line for each."""
EVALUATION = "evaluation-"
"""Beginning of the name of the folder in which a checkpoint's later test is, inside the folder of its run."""
FROM_TRAJECTORY = f"{EVALUATION}best-trajectory"
"""Folder of the test with rays from where the car was in past, present and future frames."""
OVERRIDES = "overrides"
"""Fact of later tests: what they change in the configuration of the checkpoint."""

HINTS = {
    **dict.fromkeys(("run", "checkpoint", "preset", "command", "commit", "data", "machine", FINISHED), str),
    **dict.fromkeys(("seed", "steps"), int),
    **dict.fromkeys((MINUTES, EARLIER_MINUTES, CANDIDATES, "peak MiB", "million parameters", "GFLOP a frame"), float),
    **{"stages": dict[str, int], PROTOCOL: dict[str, str], OVERRIDES: list[str], "classes": list[dict[str, Any]]},
}
"""Types of the facts that a run records beside its figures."""
LARGEST = 3.5e38
"""More than any figure is: they are computed in single precision, and the square of one is still a number."""


def says_the_same(one: str, other: str) -> bool:
    """Return whether two lines of a protocol tell of one way to count: equal, or one only says more at its end."""
    return one == other or one.startswith(f"{other}; ") or other.startswith(f"{one}; ")


def utc_text(time: float) -> str:
    """Return seconds since 1970 as a date and time in UTC, such as `2026-11-25T16:30:00Z`."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def save_results(folder: Path, metrics: Mapping[str, float], facts: Mapping[str, Any]) -> None:
    """Write `table.md`, then `metrics.json`, which marks the run as finished.

    Figures of classes without cases are NaN. Lists and mappings among the facts are written to `metrics.json` only.

    Raises:
        DataError: naming the file that cannot be written.
    """
    caption = ", ".join(f"{key} {value}" for key, value in facts.items() if not isinstance(value, list | dict))
    atomic_write(folder / "table.md", as_markdown(metrics, caption, facts.get(PROTOCOL, {})))
    plain = {key: None if math.isnan(value) else value for key, value in metrics.items()}
    atomic_write(folder / METRICS, json.dumps({**facts, "metrics": plain}, indent=1) + "\n")


def load_results(folder: Path) -> tuple[dict[str, Any], dict[str, float]]:
    """Return facts and figures of a finished run; NaN for classes without cases.

    Raises:
        UserError: naming the file, when it is damaged.
    """
    path = folder / METRICS
    try:
        facts = parse_json(read_short_text(path))
        metrics = facts.pop("metrics")
        if wrong := [key for key, hint in HINTS.items() if key in facts and not fits(facts[key], hint)]:
            raise ValueError(f"{wrong[0]} is {repr_of(facts[wrong[0]])}")
        if any("<" in line for line in facts.get(PROTOCOL, {}).values()):  # it is printed into pages as it is
            raise ValueError(f"a line of its {PROTOCOL} has tags")
        if wrong := [entry for entry in facts.get("classes", []) if not _is_class(entry)]:
            raise ValueError(f"classes has {repr_of(wrong[0])}")
        if wrong := [key for key, value in metrics.items() if not _is_figure(value)]:
            raise ValueError(f"{wrong[0]} is {repr_of(metrics[wrong[0]])}")
        return facts, {key: math.nan if value is None else float(value) for key, value in metrics.items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else first_line(error)
        raise UserError(f"{path} is damaged ({reason}); remove it, and the command that made it tests again") from error


def _is_class(entry: Mapping[str, Any]) -> bool:
    name, rgb = entry.get("name"), entry.get("rgb")
    return isinstance(name, str) and isinstance(rgb, list) and len(rgb) == 3 and all(part in range(256) for part in rgb)


def _is_figure(value: Any) -> bool:
    return value is None or (fits(value, float) and not abs(value) > LARGEST)


def trajectory_figures(folder: Path, data: Any) -> dict[str, float]:
    """Return the scores of a run's best checkpoint by the origins of its rays; none if that was not tested.

    `test/trajectory/rayiou` is over all rays, `test/trajectory/rayiou_past`, `..._now` and `..._future` are over those
    from where the car was before, at and after the scored frame. A test that changed the configuration, or was on other
    data than the run's, does not count.

    Raises:
        UserError: naming the file, when it is damaged.
    """
    if not os.path.lexists(folder / FROM_TRAJECTORY / METRICS):
        return {}
    facts, metrics = load_results(folder / FROM_TRAJECTORY)
    if facts.get("data") != data or facts.get(OVERRIDES) != []:
        return {}
    keys = ["rayiou", *(f"rayiou_{name}" for name in ORIGINS)]
    return {f"test/trajectory/{key}": metrics[f"test/{key}"] for key in keys if f"test/{key}" in metrics}


def show_results(folder: Path) -> None:
    """Print the table of a finished run and where its files are; report the folder to the parent process."""
    facts, metrics = load_results(folder)
    table = as_text(metrics, facts.get(PROTOCOL, {})).strip("\n")
    print(f"\n{table or 'No test frame has labels, so nothing is scored.'}\n")
    images = sorted(str(path) for path in (folder / IMAGES).glob("test-*.png"))
    lines = [f"table     {folder / 'table.md'}", f"figures   {folder / METRICS}"]
    print("\n".join([*lines, *(f"image     {path}" for path in images)]), flush=True)
    write_status(Status("running", "finished", results=str(folder.resolve())))
