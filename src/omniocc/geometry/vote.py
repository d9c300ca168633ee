"""Voxel labels from labelled points."""

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from omniocc.classes import FREE, NUM_CLASSES, UNKNOWN


def majority(
    cells: Int64[Tensor, " P"], labels: UInt8[Tensor, " P"], num_cells: int, num_classes: int = NUM_CLASSES
) -> UInt8[Tensor, " cells"]:
    """Gives each cell the most frequent class of the points in it.

    A tie goes to the highest class id (the thin classes Pole, Pedestrian and Roadline are the last). Unknown points
    (255) do not vote; a cell with unknown points only is unknown. A cell without points is free (0).

    Args:
        cells: cell of each point.
        labels: class of each point, 1 .. num_classes-1 or 255.
        num_cells: length of the result.
        num_classes: number of classes, free included.

    Raises:
        ValueError: if a label is free or not a class.
    """
    present = torch.bincount(labels, minlength=256).nonzero().flatten().tolist()
    wrong = [label for label in present if label == FREE or num_classes <= label != UNKNOWN]
    if wrong:
        raise ValueError(f"points must have a class 1..{num_classes - 1} or {UNKNOWN} (unknown), got labels {wrong}")
    key_type = torch.int32 if num_cells < 2**23 else torch.int64
    keys, counts = torch.unique_consecutive((cells.to(key_type) * 256 + labels).sort().values, return_counts=True)
    label = (keys % 256).long()
    # most votes first, then the higher class; unknown counts as no vote at all
    score = torch.where(label == UNKNOWN, 0, counts) * 256 + label
    best = score.new_zeros(num_cells).scatter_reduce_(0, (keys // 256).long(), score, "amax")
    return (best % 256).to(torch.uint8)
