"""Fractions of the classes among occupied voxels, beside the published ones of the paper's dataset."""

from collections.abc import Sequence

import numpy as np

from omniocc.classes import CLASSES, FREE, NUM_CLASSES
from omniocc.data.labels.voxels import vote
from omniocc.data.store.reader import SceneReader
from omniocc.geometry import Grid

PUBLISHED_PERCENT: dict[str, float] = {
    "Road": 57.03,
    "Sidewalk": 13.96,
    "Ground": 13.63,
    "Building": 6.83,
    "Wall": 2.04,
    "Vegetation": 6.83,
    "Vehicle": 0.56,
    "Other": 0.71,
    "Pole": 0.36,
    "Pedestrian": 0.02,
    "Roadline": 1.09,
}
"""Percent of occupied voxels, from the legend on the authors' page; they add up to 103, so one is a misprint."""


def cells_per_class(voxels: np.ndarray) -> np.ndarray:
    """Return the (12,) int64 number of cells of each class in labels (...) uint8; unknown is not counted."""
    return np.bincount(np.asarray(voxels, np.uint8).ravel(), minlength=256)[:NUM_CLASSES]


def count_voxels(scene: SceneReader, frames: Sequence[int], geometry: Grid) -> np.ndarray:
    """Return the (12,) int64 number of cells of each class over some frames of a scene; unknown is not counted."""
    counts = (cells_per_class(vote(scene, frame, geometry).numpy()) for frame in frames)
    return sum(counts, np.zeros(NUM_CLASSES, dtype=np.int64))


def occupied_percent(counts: np.ndarray) -> dict[str, float]:
    """Return the percentage of each class among occupied cells, by name, from counts (12,)."""
    occupied = max(int(counts.sum() - counts[FREE]), 1)
    return {row.name: 100.0 * float(counts[row.id]) / occupied for row in CLASSES if row.id != FREE}


def fraction_table(counts: np.ndarray) -> str:
    """Return lines with our percentages beside the published ones, marked where they differ by a factor of two."""
    lines = [f"{'class':<12}{'ours %':>8}{'authors %':>11}"]
    for name, ours in occupied_percent(counts).items():
        theirs = PUBLISHED_PERCENT[name]
        far = "  more than a factor of two apart" if not theirs / 2 <= ours <= theirs * 2 else ""
        lines.append(f"{name:<12}{ours:>8.2f}{theirs:>11.2f}{far}")
    return "\n".join(lines)
