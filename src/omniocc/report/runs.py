"""The records of all finished runs of a folder, with names and colours of the classes that they scored."""

import colorsys
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import quote

from omniocc.errors import UserError, repr_of
from omniocc.io import checked_name
from omniocc.progress import Progress
from omniocc.report.archive import is_archive
from omniocc.runs.curves import Curve, read_curves
from omniocc.runs.folder import command_of
from omniocc.runs.renamed import read_config
from omniocc.runs.results import CANDIDATES, METRICS, load_results, trajectory_figures
from omniocc.runs.scenes import scene_figures
from omniocc.runs.table import class_names

GRID = "grid"
"""Stands for the kind of grid of runs whose configuration was not saved."""
HASH = re.compile(r"-[0-9a-f]{8}(-\d+)?$")
RAY_IOU = "test/rayiou"
TRAINING, VALIDATION = "train/loss", "val/rayiou"
"""Keys of the curves that are drawn."""
SETTING, UNKNOWN = ("preset", "steps", "data"), "unknown"
"""Facts that must be equal for a comparison, by which the folder of a report is called, and what stands for none."""
FRACTION, RECALL, VOXELS = "test/sketch/fraction", "test/sketch/recall", "voxels"


class FinishedRun(NamedTuple):
    """A finished run.

    Attributes:
        name: name of its folder.
        facts: its records besides figures (seed, steps, classes ...).
        metrics: its figures by key; NaN for classes without cases.
        config: its resolved configuration; empty if it was not saved.
        same_as: the row with its configuration, if its name is not that of a row.
        curves: its curves of training and validation that are drawn, by key.
    """

    name: str
    facts: dict
    metrics: dict[str, float]
    folder: Path = Path()
    config: Mapping[str, Any] = MappingProxyType({})
    same_as: str | None = None
    curves: Mapping[str, Curve] = MappingProxyType({})

    @property
    def row(self) -> str:
        """Return its row in the tables: the one whose configuration it has, or the name it was given."""
        return self.same_as or HASH.sub("", self.name)

    @property
    def command(self) -> str | None:
        """Return the command that made it, with the packages that it needs; None if it was not recorded."""
        return command_of(self.facts, self.config)

    @property
    def link(self) -> Path | None:
        """Return the folder for links to it; None for a run of an archive, whose folder is gone after the report."""
        return None if is_archive(self.folder.parent) else self.folder

    @property
    def place(self) -> tuple[str, Any]:
        """Return row and seed; of several runs with the same, one is used."""
        return self.row, self.facts.get("seed")

    @property
    def setting(self) -> tuple[str, ...]:
        """Return preset, steps and data, which must be equal for a comparison."""
        return tuple(str(self.facts.get(key, UNKNOWN)) for key in SETTING)


def read_runs(folder: Path) -> list[FinishedRun]:
    """Return finished runs by falling RayIoU, unknown ones last.

    Damaged ones are left out with a warning that names the file.

    Raises:
        UserError: when there is none.
    """
    runs, folders = [], sorted(path for path in folder.glob("*") if os.path.lexists(path / METRICS))
    with Progress("reading runs", len(folders), unit="runs") as progress:
        for path in folders:
            try:
                runs.append(_read(path))
            except (UserError, OSError) as error:
                progress.message(f"left out: {error}")
            progress.advance()
    if not runs:
        raise UserError(f"{folder} holds no finished run ({METRICS}); train one: python src/train.py")
    return sorted(runs, key=lambda run: (math.isnan(run.metrics[RAY_IOU]), -run.metrics[RAY_IOU]))


def _read(folder: Path) -> FinishedRun:
    if not folder.name.isprintable():
        raise UserError(
            f"a run's folder is named {repr_of(folder.name)}, which cannot be written into tables: rename it"
        )
    facts, metrics = load_results(folder)
    if RAY_IOU not in metrics:
        raise UserError(f"{folder / METRICS} has no RayIoU: its test frames have no voxel labels")
    for key in SETTING:
        checked_name(f"{folder / METRICS}: {key}", str(facts.get(key, UNKNOWN)))
    config = read_config(path) if os.path.lexists(path := folder / "config.yaml") else {}
    curves = read_curves(folder)
    figures = known_figures(facts, config) | metrics | scene_figures(folder)
    figures |= trajectory_figures(folder, facts.get("data"))
    drawn = {key: curves[key] for key in (TRAINING, VALIDATION) if key in curves}
    return FinishedRun(folder.name, facts, figures, folder, config, curves=drawn)


def known_figures(facts: Mapping[str, Any], config: Mapping[str, Any]) -> dict[str, float]:
    """Return figures that need no test: number of voxels, and the candidates of a sketch that is not a stage."""
    figures = {}
    if shape := grid_of(config).get("shape"):
        figures[VOXELS] = float(math.prod(shape))
    if (fraction := facts.get(CANDIDATES)) is not None:
        figures[FRACTION] = float(fraction)
        figures |= {RECALL: 1.0} if fraction == 1 else {}  # every voxel is a candidate, so none is missed
    return figures


def grid_of(config: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the grid of a configuration, as keys and values; none where it was not saved."""
    return config.get("model", {}).get("geometry") or {}


def grid_kind(config: Mapping[str, Any]) -> str:
    """Return the kind of grid of a run in a word; `GRID` where its configuration was not saved."""
    return (grid_of(config).get("_target_") or GRID).rsplit(".", 1)[-1].lower()


def grid_name(config: Mapping[str, Any]) -> str:
    """Return kind and shape of the grid that a run predicts, for example `cylinder 64x100x8`."""
    shape = grid_of(config).get("shape") or []
    return f"{grid_kind(config)} {'x'.join(map(str, shape))}".strip()


def path_between(start: Path, target: Path) -> str:
    """Return the link to a file or folder from a page in the folder `start`."""
    return quote(os.path.relpath(target.resolve(), start.resolve()))


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
