"""Names and colours of classes, as the runs recorded them."""

import colorsys
from collections.abc import Sequence

from omniocc.report.runs import FinishedRun
from omniocc.run.table import class_names


def names_of(runs: Sequence[FinishedRun]) -> list[str]:
    """Return the names of all classes that the runs have scored, in the order recorded."""
    return list(dict.fromkeys(name for run in runs for name in class_names(run.metrics)))


def colors_of(runs: Sequence[FinishedRun]) -> dict[str, tuple[int, ...]]:
    """Return RGB (0 to 255) of every class by name; evenly spaced hues where no run recorded a colour."""
    names = names_of(runs)
    recorded = {entry["name"]: tuple(entry["rgb"]) for run in runs for entry in run.facts.get("classes", [])}
    hues = [colorsys.hsv_to_rgb(k / len(names), 0.6, 0.8) for k in range(len(names))]
    spread = {name: tuple(round(255 * part) for part in hue) for name, hue in zip(names, hues, strict=True)}
    return {name: recorded.get(name, spread[name]) for name in names}
