"""Configurations of older versions, in which classes had other names."""

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
CLASSES = {f"{old}.{name}": f"{new}.{name}" for old, (new, names) in MOVED.items() for name in names}
"""New names of classes by their old ones."""


def renamed(tree: Any) -> Any:
    """Return plain data with the new names of classes."""
    if isinstance(tree, Mapping):
        return {
            key: CLASSES.get(value, value) if key == "_target_" and isinstance(value, str) else renamed(value)
            for key, value in tree.items()
        }
    return [renamed(value) for value in tree] if isinstance(tree, list) else tree
