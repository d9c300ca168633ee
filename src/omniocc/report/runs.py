"""All finished runs of a folder, side by side."""

import math
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import yaml

from omniocc.errors import UserError
from omniocc.run.folder import METRICS, VOLATILE
from omniocc.run.results import load_results
from omniocc.run.table import band_keys, number

HASH = re.compile(r"-[0-9a-f]{8}(-\d+)?$")
FRACTION, RECALL, VOXELS = "test/sketch/fraction", "test/sketch/recall", "voxels"
ABSENT = object()
OF_MACHINES = ("root", "cache", "workers", "num_workers", "accelerator", "seed")
"""Keys at any depth that may differ between runs of one row."""


class FinishedRun(NamedTuple):
    """A finished run.

    Attributes:
        name: of its folder.
        facts: what was recorded of it.
        metrics: its figures.
        folder: where it lies.
        config: its resolved configuration; empty if it was not saved.
        same_as: the row whose configuration it has, where its own name is not that of a row.
    """

    name: str
    facts: dict
    metrics: dict[str, float]
    folder: Path = Path()
    config: Mapping[str, Any] = MappingProxyType({})
    same_as: str | None = None

    @property
    def row(self) -> str:
        """Return its row in the tables: the one whose configuration it has, or the name it was given."""
        return self.same_as or HASH.sub("", self.name)

    @property
    def place(self) -> tuple[str, Any]:
        """Row and seed: where one run counts."""
        return self.row, self.facts.get("seed")

    @property
    def setting(self) -> tuple[str, ...]:
        """What runs must have in common to be compared."""
        return tuple(str(self.facts.get(key, "unknown")) for key in ("preset", "steps", "data"))


def read_runs(folder: Path) -> list[FinishedRun]:
    """Finished runs by falling RayIoU; those whose files are damaged are left out with a warning that names the file.

    Raises:
        UserError: when there is none.
    """
    found = [_read_or_tell(path.parent) for path in sorted(folder.glob(f"*/{METRICS}"))]
    runs = [run for run in found if run is not None]
    if not runs:
        raise UserError(f"{folder} holds no finished run ({METRICS}); train one: python src/train.py")
    return sorted(runs, key=lambda run: -run.metrics["test/rayiou"])


def _read_or_tell(folder: Path) -> FinishedRun | None:
    try:
        return _read(folder)
    except UserError as error:
        print(f"left out: {error}", file=sys.stderr, flush=True)
        return None


def _read(folder: Path) -> FinishedRun:
    facts, metrics = load_results(folder)
    config = _read_config(folder / "config.yaml")
    return FinishedRun(folder.name, facts, figures_of_config(config) | metrics, folder, config)


def _read_config(path: Path) -> Mapping[str, Any]:
    if not path.exists():
        return {}
    try:
        config = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is damaged: {str(error).splitlines()[0]}") from error
    if not isinstance(config, dict):
        raise UserError(f"{path} is damaged: it holds no configuration")
    return config


def figures_of_config(config: Mapping[str, Any]) -> dict[str, float]:
    """What a configuration decides alone: number of voxels; share of candidates where the sketch looks at nothing."""
    model = config.get("model", {})
    figures = {}
    if "shape" in model.get("geometry", {}):
        figures[VOXELS] = float(math.prod(model["geometry"]["shape"]))
    sketch = model.get("sketch", {})
    if sketch.get("_target_", "").endswith(".Dense"):
        figures |= {FRACTION: 1.0, RECALL: 1.0}
    if sketch.get("_target_", "").endswith(".Random"):
        figures[FRACTION] = float(sketch["ratio"])
    return figures


def comparable(runs: Sequence[FinishedRun], preset: str | None) -> tuple[list[FinishedRun], str]:
    """The runs of one preset, number of steps and dataset, and a sentence on what they are and what is left out.

    Of several runs of a row with one seed the newest is taken.

    Args:
        runs: at least one.
        preset: theirs; None takes the setting that most runs have.

    Raises:
        UserError: when no run has that preset.
    """
    candidates = [run for run in runs if preset in (None, run.facts.get("preset"))]
    if not candidates:
        found = sorted({str(run.facts.get("preset", "unknown")) for run in runs})
        raise UserError(f"no finished run of preset {preset}; there are runs of {', '.join(found)}")
    chosen = Counter(run.setting for run in candidates).most_common(1)[0][0]
    same = [run for run in candidates if run.setting == chosen]
    kept = _newest(same)
    commits = sorted({str(run.facts.get("commit", "unknown")) for run in kept})
    name, steps, data = chosen
    text = f"preset={name}, {steps} steps, data {data[:8]}, commit {', '.join(commits)}."
    if others := sorted(run.name for run in runs if run.setting != chosen):
        text += f" Left out, of another setting: {', '.join(others)}."
    if alike := sorted(f"{run.name} ({run.same_as})" for run in kept if run.same_as):
        text += f" Counted in the row whose configuration they have: {', '.join(alike)}."
    if older := sorted(_replaced(same, kept)):
        text += f" Left out, older runs of the same row and seed: {', '.join(older)}."
    return kept, text + "".join(f" {line}" for line in _mixtures(by_row(kept)))


def _newest(runs: Sequence[FinishedRun]) -> list[FinishedRun]:
    def age(run: FinishedRun) -> tuple[float, str]:
        path = run.folder / METRICS
        return (path.stat().st_mtime if path.exists() else 0.0, run.name)

    newest = {run.place: run for run in sorted(runs, key=age)}
    return [run for run in runs if newest[run.place] is run]


def _replaced(runs: Sequence[FinishedRun], kept: Sequence[FinishedRun]) -> Iterator[str]:
    """Names of runs that are not kept, and in what they differ from the one that is."""
    newest = {run.place: run for run in kept}
    for run in runs:
        if (newer := newest[run.place]) is not run:
            keys = differences([run, newer])
            yield run.name + (f" (of another {keys} than {newer.name})" if keys else "")


def _mixtures(rows: Mapping[str, Sequence[FinishedRun]]) -> Iterator[str]:
    """A warning for each row whose seeds were trained with other values of one key."""
    for row, runs in rows.items():
        if keys := differences(runs):
            yield f"Mind: the runs of row {row} differ in {keys}; another name=... makes a row of its own."


def differences(runs: Sequence[FinishedRun]) -> str:
    """Keys, four at most, which not all of the runs have with the same value.

    A key that only one of two commits had is a new option, not a difference.
    """
    found: set[str] = set()
    versions = [(run.facts.get("commit"), compared(run.config)) for run in runs]
    for (commit, left), (other_commit, right) in combinations(versions, 2):
        keys = left.keys() | right.keys() if commit == other_commit else left.keys() & right.keys()
        found |= {key for key in keys if left.get(key, ABSENT) != right.get(key, ABSENT)}
    keys = sorted(found)
    return f"{', '.join(keys[:4])}{' and more' * (len(keys) > 4)}"


def compared(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return what runs of one row have in common, by dotted key: all but name, seed, machine and `VOLATILE`."""
    return dict(_flat({key: value for key, value in config.items() if key not in ("name", *VOLATILE)}))


def _flat(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in config.items():
        if key in OF_MACHINES:
            continue
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def by_row(runs: Sequence[FinishedRun]) -> dict[str, list[FinishedRun]]:
    """Runs of each row of the tables, by seed.

    Raises:
        UserError: when a row has two runs with the same seed, since then they differ in something else.
    """
    rows: dict[str, list[FinishedRun]] = {}
    for run in sorted(runs, key=lambda run: run.facts.get("seed") or 0):
        rows.setdefault(run.row, []).append(run)
    for row, members in rows.items():
        seed, times = Counter(run.facts.get("seed") for run in members).most_common(1)[0]
        if times > 1:
            names = ", ".join(run.name for run in members if run.facts.get("seed") == seed)
            raise UserError(f"row {row} has {times} runs with seed {seed} ({names}); move all but one elsewhere")
    return rows


def table_of_runs(runs: list[FinishedRun]) -> tuple[list[str], list[list[str]]]:
    """Head and rows: run, seed, steps, RayIoU, its distance bands, RayIoU against LiDAR rays, mIoU."""
    bands = band_keys(runs[0].metrics)
    head = [
        "run",
        "seed",
        "steps",
        "RayIoU",
        *(band.removeprefix("rayiou_") for band in bands),
        "RayIoU, LiDAR",
        "mIoU",
    ]
    keys = ["rayiou", *bands, "lidar/rayiou", "voxel/miou"]
    rows = [
        [
            run.name,
            str(run.facts.get("seed", "–")),
            str(run.facts.get("steps", "–")),
            *(number(run.metrics.get(f"test/{key}")) for key in keys),
        ]
        for run in runs
    ]
    return head, rows
