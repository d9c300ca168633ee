"""Configurations of older versions, in which classes and keys had other names."""

import re
from collections.abc import Mapping
from typing import Any

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


def new_key(key: str) -> str | None:
    """Return the dotted key that has replaced one of the command line; None if none has."""
    parent, _, last = key.rpartition(".")
    if key == "data.unknown":
        return "data.ignore"
    return ".".join(filter(None, (parent, KEYS[last]))) if last in KEYS else None
