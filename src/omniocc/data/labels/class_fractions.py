"""Shares of the classes among occupied voxels, beside those of the paper's dataset."""

from collections.abc import Sequence

import numpy as np

from omniocc.classes import CLASSES, FREE, NUM_CLASSES
from omniocc.data.labels.voxels import vote
from omniocc.data.store.reader import SceneReader
from omniocc.geometry import Grid
from omniocc.world.shares import AUTHORS_SHARES


def spread(count: int, wanted: int) -> list[int]:
    """At most `wanted` of the numbers 0 to `count` - 1, evenly spread, the first and the last included."""
    return sorted({round(at) for at in np.linspace(0, count - 1, min(count, wanted)).tolist()})


def count_voxels(scene: SceneReader, frames: Sequence[int], geometry: Grid) -> np.ndarray:
    """(12,) int64 number of cells of each class over these frames; unknown is not counted."""
    counts = np.zeros(NUM_CLASSES, dtype=np.int64)
    for frame in frames:
        counts += np.bincount(vote(scene, frame, geometry).numpy().ravel(), minlength=256)[:NUM_CLASSES]
    return counts


def occupied_percent(counts: np.ndarray) -> dict[str, float]:
    """Share of each class among occupied cells, by name."""
    occupied = max(int(counts.sum() - counts[FREE]), 1)
    return {row.name: 100.0 * float(counts[row.id]) / occupied for row in CLASSES if row.id != FREE}


def share_table(counts: np.ndarray) -> str:
    """Lines of ours beside the authors'; marked where they differ by more than two times."""
    lines = [f"{'class':<12}{'ours %':>8}{'authors %':>11}"]
    for name, ours in occupied_percent(counts).items():
        theirs = AUTHORS_SHARES[name]
        far = "  more than two times apart" if not theirs / 2 <= ours <= theirs * 2 else ""
        lines.append(f"{name:<12}{ours:>8.2f}{theirs:>11.2f}{far}")
    return "\n".join(lines)
