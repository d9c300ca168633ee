"""How often each class occurs among occupied voxels, beside the legend of the authors' own site."""

import numpy as np

from omniocc.classes import CLASSES

AUTHORS_SHARES: dict[str, float] = {
    "Road": 57.03, "Sidewalk": 13.96, "Ground": 13.63, "Building": 6.83, "Wall": 2.04, "Vegetation": 6.83,
    "Vehicle": 0.56, "Other": 0.71, "Pole": 0.36, "Pedestrian": 0.02, "Roadline": 1.09,
}  # fmt: skip
"""Percent of occupied voxels, from the figure's legend; they add up to 103, so one of them is a misprint."""


def occupied_shares(voxels: np.ndarray) -> dict[str, float]:
    """Percent of the occupied cells of class labels (...) uint8 by class name; free and unknown do not count."""
    count = np.bincount(np.asarray(voxels, np.uint8).ravel(), minlength=256)[1 : len(CLASSES)]
    return {row.name: float(100 * n / max(count.sum(), 1)) for row, n in zip(CLASSES[1:], count, strict=True)}


def shares_table(ours: dict[str, float]) -> str:
    """Ours beside the authors', with the factor between them; `*` marks more than two times."""
    lines = [f"{'class':<12}{'ours %':>8}{'authors %':>11}{'factor':>9}"]
    for name, theirs in AUTHORS_SHARES.items():
        factor = ours[name] / theirs
        mark = " " if 0.5 <= factor <= 2 else "*"
        lines.append(f"{name:<12}{ours[name]:>8.2f}{theirs:>11.2f}{factor:>8.2f}{mark}")
    return "\n".join(lines)
