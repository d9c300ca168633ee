"""What disturbances cost a system: the scores of a robustness test, part by part, their drops, and its files."""

import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from omniocc.bounds import fits
from omniocc.errors import UserError, first_line, repr_of
from omniocc.io import atomic_write, checked_name, parse_json, read_short_text
from omniocc.runs.results import LARGEST

UNDISTURBED = "undisturbed"
"""Name of the part, and of its group, to which all others are compared."""
ROBUSTNESS = "robustness.json"
"""File with all parts of a checkpoint; it is in a folder that begins with `FOLDER`."""
FOLDER = "robustness-"
TESTS = f"{FOLDER}*/{ROBUSTNESS}"
"""Pattern of these files in the folder of a run; those of shipped weights are in the folder of all runs."""
RAY_IOU = "rayiou"
HINTS = {"part": str, "group": str, "scenes": list[str], "frames": int, "seconds": float}
"""Types of what a part holds beside its scores."""
FACTS, LEFT_OUT = dict[str, Any], "left out"
"""Type of the facts of a test, and the one of them that is a list of sentences."""
WITHIN = "rayiou_within_"
"""Beginning of the keys of RayIoU within nested ranges, which end with the range (`8.5m`)."""


class PartScores(NamedTuple):
    """The scores of a system under one disturbance.

    Attributes:
        part: name of the disturbance, with its strength and unit.
        group: kind of disturbance.
        scenes: names of the scenes that were scored.
        frames: number of frames that were scored.
        seconds: wall-clock time of prediction and scores; rendering is not counted.
        scores: over all scenes, by key: `rayiou`, `rayiou_within_<range>m`, `lidar/rayiou`, `voxel/iou`, `voxel/miou`.
        without: the same scores over all scenes but one, by key, in the order of the scenes.
    """

    part: str
    group: str
    scenes: Sequence[str]
    frames: int
    seconds: float
    scores: Mapping[str, float]
    without: Mapping[str, Sequence[float]]


class Robustness(NamedTuple):
    """The parts of one checkpoint, and facts about the test.

    Attributes:
        system: name of the folder of its run, or of shipped weights.
        facts: about the test.
        parts: its scores, the undisturbed ones first.
        training: steps and seed of its training in words; empty if they are not known.
    """

    system: str
    facts: Mapping[str, Any]
    parts: Sequence[PartScores]
    training: str = ""

    @property
    def undisturbed(self) -> PartScores:
        """Return the scores without any disturbance."""
        return self.parts[0]

    @property
    def disturbed(self) -> Sequence[PartScores]:
        """Return all other parts."""
        return self.parts[1:]

    @property
    def groups(self) -> dict[str, list[PartScores]]:
        """Return the parts of each kind of disturbance, in order."""
        found: dict[str, list[PartScores]] = {}
        for part in self.disturbed:
            found.setdefault(part.group, []).append(part)
        return found


class Drop(NamedTuple):
    """How much lower a score is than without disturbance, and the standard error of that over scenes."""

    value: float
    error: float


def drop_of(part: PartScores, undisturbed: PartScores, key: str = RAY_IOU) -> Drop:
    """Return what a disturbance costs; nan where one of both has no such score.

    The error is the jackknife's (Efron and Tibshirani 1993, equation 11.5): of the difference on the same scenes, or of
    both sides where the scenes differ. It is nan for a single scene.
    """
    if key not in part.scores or key not in undisturbed.scores:
        return Drop(math.nan, math.nan)
    value = undisturbed.scores[key] - part.scores[key]
    ours, theirs = (np.array(one.without[key], dtype=np.float64) for one in (undisturbed, part))
    if list(part.scenes) == list(undisturbed.scenes):
        return Drop(value, jackknife_error(ours - theirs))
    return Drop(value, math.hypot(jackknife_error(ours), jackknife_error(theirs)))


def jackknife_error(without: Float[np.ndarray, " scenes"]) -> float:
    """Return the standard error of a figure from its values over all scenes but one."""
    count = len(without)
    if count < 2:
        return math.nan
    return math.sqrt((count - 1) / count * float(np.square(without - without.mean()).sum()))


def relative_drop(part: PartScores, undisturbed: PartScores, key: str = RAY_IOU) -> float:
    """Return the drop divided by the undisturbed score; nan where that is 0 or not known."""
    base = undisturbed.scores.get(key, math.nan)
    return drop_of(part, undisturbed, key).value / base if base > 0 else math.nan


def drops_by_kind(record: Robustness, parts: set[str] | None = None) -> dict[str, float]:
    """Return the mean relative drop of RayIoU by kind of disturbance, over all parts of it, or those named."""
    return {
        group: float(np.mean([relative_drop(part, record.undisturbed) for part in chosen]))
        for group, members in record.groups.items()
        if (chosen := [part for part in members if parts is None or part.part in parts])
    }


def save_part(path: Path, part: PartScores, key: str) -> None:
    """Write a finished part; `key` stands for everything that decides its figures."""
    atomic_write(path, json.dumps({"key": key, **_plain(part)}, indent=1) + "\n")


def load_part(path: Path, key: str) -> PartScores | None:
    """Return a part that was finished before under the same key; None if there is none.

    Raises:
        UserError: naming a damaged file.
    """
    if not path.exists():
        return None
    try:
        content = parse_json(read_short_text(path))
        return _part(content) if content.pop("key") == key else None
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise UserError(f"{path} is damaged ({first_line(error)}); remove it, and it is computed again") from error


def save_robustness(folder: Path, record: Robustness) -> Path:
    """Write all parts of a checkpoint as one file, and return it."""
    parts = [_plain(part) for part in record.parts]
    path = folder / ROBUSTNESS
    atomic_write(path, json.dumps({"system": record.system, "facts": dict(record.facts), "parts": parts}) + "\n")
    return path


def load_robustness(path: Path) -> Robustness:
    """Return the parts of a checkpoint.

    Raises:
        UserError: naming a damaged file.
    """
    try:
        content = parse_json(read_short_text(path))
        system = checked_name("system", content["system"])
        facts, parts = content["facts"], [_part(part) for part in content["parts"]]
        if not (fits(facts, FACTS) and fits(facts.get(LEFT_OUT, []), list[str])) or not parts:
            raise ValueError(f"its facts are {repr_of(facts)}" if parts else "it has no parts")
        return Robustness(system, facts, parts)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise UserError(
            f"{path} is damaged ({first_line(error)}); the command that made it writes it again from its parts"
        ) from error


def read_robustness(runs: Path) -> list[Robustness]:
    """Return all tests in a folder of runs, by name of their system; damaged ones are left out with a warning."""
    found = []
    folders = [*runs.glob(f"{FOLDER}*"), *runs.glob(f"*/{FOLDER}*")]
    for path in sorted(folder / ROBUSTNESS for folder in folders if os.path.lexists(folder / ROBUSTNESS)):
        try:
            found.append(load_robustness(path))
        except (UserError, OSError) as error:
            print(f"left out: {error}", file=sys.stderr, flush=True)
    return sorted(found, key=lambda record: record.system)


def _plain(part: PartScores) -> dict[str, Any]:
    return {
        **part._asdict(),
        "scenes": list(part.scenes),
        "scores": {key: _number(value) for key, value in part.scores.items()},
        "without": {key: [_number(value) for value in values] for key, values in part.without.items()},
    }


def _part(content: dict[str, Any]) -> PartScores:
    scores = {key: _float(value) for key, value in content["scores"].items()}
    without = {key: [_float(value) for value in values] for key, values in content["without"].items()}
    kept = {name: content[name] for name in HINTS}
    for name in ("part", "group"):
        checked_name(name, kept[name])
    if wrong := [name for name, hint in HINTS.items() if not fits(kept[name], hint)]:
        raise ValueError(f"{wrong[0]} is {repr_of(kept[wrong[0]])}")
    counts = {len(kept["scenes"]), 0 if len(kept["scenes"]) == 1 else None}  # without its only scene nothing is left
    if wrong := [key for key in scores if len(without[key]) not in counts]:
        raise ValueError(f"without.{wrong[0]} is not one number for each scene")
    return PartScores(**kept, scores=scores, without=without)


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def _float(value: float | None) -> float:
    if not (value is None or fits(value, float)) or abs(value or 0) > LARGEST:
        raise ValueError(f"a score is {repr_of(value)}")
    return math.nan if value is None else float(value)
