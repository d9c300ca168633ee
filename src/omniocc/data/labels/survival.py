"""How many of a dataset's labels are left in the grid of a model."""

import torch

from omniocc.classes import FREE, UNKNOWN
from omniocc.data.source import SceneFrames, VoxelLabels
from omniocc.geometry import Grid

FEWEST = 0.01
"""Fraction of the labels that a grid has to keep: one whose cells are 4 times as long keeps a sixteenth of surfaces."""


def lost_line(scene: SceneFrames, labels: VoxelLabels, geometry: Grid) -> str | None:
    """Return a line if hardly any labels of a scene's first frame are left in the grid of the model; None otherwise.

    Compared are the occupied cells of the dataset's own grid with those of the model's; of datasets without a grid all
    points with those inside of the model's.

    Raises:
        DataError: naming a damaged file.
    """
    truth = labels.benchmark(scene, 0)
    if truth is not None and (voxels := labels.read(scene, 0)) is not None:
        kind, kept, total = "occupied cells of the dataset", _occupied(voxels), _occupied(truth.voxels)
    elif (points := scene.points(0)) is not None:
        inside = geometry.flat_index(torch.from_numpy(points.points_m))[1]
        kind, kept, total = "points", int(inside.sum()), len(inside)
    else:
        return None
    if kept >= FEWEST * total:
        return None
    return (
        f"the model's grid keeps {kept:,} of {total:,} {kind} in the first training frame, so that there is hardly "
        "anything to learn and scores mean little: its cells are too large (preset=smoke?), or it lies elsewhere"
    )


def _occupied(voxels: torch.Tensor) -> int:
    return int(((voxels != FREE) & (voxels != UNKNOWN)).sum())
