"""Voxel labels from labelled points."""

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from omniocc.classes import FREE, NUM_CLASSES, UNKNOWN


def majority(
    cells: Int64[Tensor, " P"], labels: UInt8[Tensor, " P"], num_cells: int, num_classes: int = NUM_CLASSES
) -> UInt8[Tensor, " cells"]:
    """Gives each cell the most frequent class of the points in it.

    A tie goes to the highest class id (the thin classes Pole, Pedestrian and Roadline are the last). Unknown points (255) do not vote; a cell with
    unknown points only is unknown. A cell without points is free (0).

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
    votes = [label for label in present if label != UNKNOWN]
    rank = torch.zeros(256, dtype=torch.int64, device=labels.device)
    rank[torch.tensor(present, dtype=torch.int64)] = torch.arange(len(present), device=labels.device)
    # one row per class that occurs; unknown is the largest id, so its row is the last
    keys = torch.add(cells, rank[labels.int()], alpha=num_cells)
    counts = torch.bincount(keys, minlength=len(present) * num_cells).reshape(len(present), num_cells)
    result = torch.full((num_cells,), FREE, dtype=torch.uint8, device=labels.device)
    if UNKNOWN in present:
        result[counts[-1] > 0] = UNKNOWN
    most = torch.ones(num_cells, dtype=counts.dtype, device=labels.device)
    for label, count in zip(votes, counts, strict=False):
        result.masked_fill_(count >= most, label)
        torch.maximum(most, count, out=most)
    return result
