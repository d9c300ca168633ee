"""Configurations that runs saved, also those of older versions, in which classes and keys had other names."""

import math
import re
from collections.abc import Mapping
from functools import reduce
from pathlib import Path
from typing import Any

from omniocc.bounds import fits
from omniocc.config import GROUPS
from omniocc.errors import UserError, repr_of
from omniocc.io import parse_yaml, read_short_text

MOVED = {
    "omniocc.data": ("omniworld", ["VirtualWorld"]),
    "omniocc.model.lifter": ("omniocc.extras.rivals", ["BiGrid", "CoarseToFine", "SplatColoring"]),
    "omniocc.model.refiner": ("omniocc.extras.rivals", ["ChannelToHeight", "Experts", "Focus"]),
    "omniocc.loss": ("omniocc.extras.rivals", ["Frustums", "RunLengths"]),
    "omniocc.data.source.carlasc": ("omniocc.extras.datasets.carlasc", ["CarlaSC"]),
    "omniocc.data.source.fisheye3dod": ("omniocc.extras.datasets.fisheye3dod", ["Fisheye3DOD"]),
    "omniocc.data.source.h3o": ("omniocc.extras.datasets.h3o", ["H3O"]),
    "omniocc.data.source.parkocc": ("omniocc.extras.datasets.parkocc", ["ParkOcc"]),
    "omniocc.data.source.quadocc": ("omniocc.extras.datasets.quadocc", ["QuadOcc"]),
    "omniocc.data.source.sscbench_kitti360": ("omniocc.extras.datasets.sscbench_kitti360", ["SSCBenchKITTI360"]),
    "omniocc.data.source.woodscape": ("omniocc.extras.datasets.woodscape", ["WoodScape"]),
}
"""New packages by the old ones, and the classes that moved."""
CLASSES = {f"{old}.{name}": f"{new}.{name}" for old, (new, names) in MOVED.items() for name in names} | {
    "omniocc.loss.Scal": "omniocc.loss.SceneClassAffinity",
    "omniocc.loss.Total": "omniocc.loss.TotalLoss",
}
"""New names of classes by their old ones."""
PACKAGES = {"task": "train", "run": "runs"}
"""New names of packages of `omniocc` by their old ones."""
OLD_PACKAGE = re.compile(rf"^omniocc\.({'|'.join(PACKAGES)})\.")
KEYS = {
    "behind_m": "dilation_behind_m",
    "frames_together": "samples_per_scene",
    "rate_factors": "lr_multipliers",
    "windows_m": "dilation_m",
}
"""New names of keys by their old ones."""
SHAPE = "model.geometry.shape"
MOST_VOXELS = 2**53
"""Number of voxels that no grid has: a float tells no larger ones apart."""
COUNTS = (*(f"{split}_scenes" for split in ("train", "val", "test")), "frames_per_scene")
TREE = dict[str, Any]
TREES = (*GROUPS, "model.geometry", "data.source", *(f"stages.{stage}" for stage in ("depth", "sketch", "occupancy")))
HINTS = {
    **dict.fromkeys(TREES, TREE),
    **dict.fromkeys(("preset.name", "model.geometry._target_", "data.source.rig"), str),
    **{"packages": list[str], "optimizer.learning_rate": float, SHAPE: list[int]},
    **{f"data.source.{count}": int for count in COUNTS},
}
"""Types of the values that reports use, by dotted key; any may be missing or null."""


def renamed(tree: Any) -> Any:
    """Return plain data with the new names of classes and keys."""
    if isinstance(tree, Mapping):
        return dict(_entry(key, value) for key, value in tree.items())
    return [renamed(value) for value in tree] if isinstance(tree, list) else tree


def _entry(key: Any, value: Any) -> tuple[Any, Any]:
    if key == "_target_" and isinstance(value, str):
        value = OLD_PACKAGE.sub(lambda found: f"omniocc.{PACKAGES[found[1]]}.", value)
        return key, CLASSES.get(value, value)
    if key == "unknown" and value in ("free", "unobserved", "unseen"):
        return "ignore", "none" if value == "free" else value
    return KEYS.get(key, key) if isinstance(key, str) else key, renamed(value)


def read_mapping(path: Path) -> dict[str, Any]:
    """Return the keys and values of a YAML file; none where it is empty.

    Raises:
        UserError: when it is no YAML, or holds something else.
        DataError: when it cannot be read.
    """
    try:
        content = parse_yaml(read_short_text(path)) or {}
    except ValueError as error:
        raise UserError(f"{path} is damaged: {error}") from error
    if not isinstance(content, dict):
        raise UserError(f"{path} is damaged: it holds no keys and values")
    return content


def read_config(path: Path) -> dict[str, Any]:
    """Return the configuration that a run saved, with the new names of classes and keys; without groups that are null.

    Raises:
        UserError: when it is empty, no YAML, or a value that reports use is of another type.
        DataError: when it cannot be read.
    """
    config = {
        key: value for key, value in renamed(read_mapping(path)).items() if value is not None or key not in GROUPS
    }
    if not config:
        raise UserError(f"{path} is damaged: it is empty")
    found = {key: reduce(_below, key.split("."), config) for key in HINTS}
    wrong = [key for key, value in found.items() if value is not None and not _fits(value, HINTS[key])]
    wrong += [key for key in (SHAPE,) if not wrong and not 0 <= math.prod(found[key] or ()) < MOST_VOXELS]
    if wrong:
        raise UserError(f"{path} is damaged: {wrong[0]} is {repr_of(found[wrong[0]])}")
    return config


def _below(tree: Any, name: str) -> Any:
    return tree.get(name) if isinstance(tree, dict) else None


def _fits(value: Any, hint: Any) -> bool:
    return fits(value, hint) and isinstance(value, dict) == (hint == TREE)  # `fits` takes any `_target_`


def new_key(key: str) -> str | None:
    """Return the dotted key that has replaced one of the command line; None if none has."""
    parent, _, last = key.rpartition(".")
    if key == "data.unknown":
        return "data.ignore"
    return ".".join(filter(None, (parent, KEYS[last]))) if last in KEYS else None
