"""Voxel labels by majority vote."""

import torch
from jaxtyping import Int64, Shaped, UInt8
from torch import Tensor

from rayiou.labels import FREE, NUM_CLASSES, UNKNOWN, ids_beyond


def majority_vote(
    cells: Int64[Tensor, " P"], labels: Shaped[Tensor, " P"], num_cells: int, num_classes: int = NUM_CLASSES
) -> UInt8[Tensor, " cells"]:
    """Return the most frequent class of the points in each cell.

    A tie goes to the highest class id (the thin classes Pole, Pedestrian and Roadline are the last). Unknown points
    (255) do not vote; a cell with unknown points only is unknown. A cell without points is free (0).

    Labels are 1 .. num_classes-1 or 255; `num_cells` is the length of the result.

    Raises:
        ValueError: if a label is free or not a class.
    """
    if wrong := ids_beyond(labels.cpu().numpy(), num_classes, FREE + 1):
        raise ValueError(f"points must have a class 1..{num_classes - 1} or {UNKNOWN} (unknown), got labels {wrong}")
    labels = labels.to(torch.uint8)
    key_type = torch.int32 if num_cells < 2**23 else torch.int64
    keys, counts = torch.unique_consecutive((cells.to(key_type) * 256 + labels).sort().values, return_counts=True)
    label = (keys % 256).long()
    # most votes first, then the higher class; unknown counts as no vote
    score = torch.where(label == UNKNOWN, 0, counts) * 256 + label
    best = score.new_zeros(num_cells).scatter_reduce_(0, (keys // 256).long(), score, "amax")
    return (best % 256).to(torch.uint8)


def downsample(
    labels: Shaped[Tensor, "*B X Y Z"], factor: int, num_classes: int = NUM_CLASSES
) -> UInt8[Tensor, "*B x y z"]:
    """Return coarser labels: blocks of `factor` cells along every axis joined by majority, keeping thin objects.

    Only occupied cells vote: a block with a single pole among free or unknown cells is pole. A tie goes to the highest
    class id, as in `majority_vote`. A block without occupied cells is free, or unknown if most of it is.

    Args:
        labels: class of every cell, or 255 for unknown; batch axes first.
        factor: cells along each axis that become one.
        num_classes: number of classes, free included.

    Raises:
        ValueError: if an axis is not a multiple of the factor, or a label is not a class.
    """
    if wrong := ids_beyond(labels.cpu().numpy(), num_classes):
        raise ValueError(f"labels must be classes 0..{num_classes - 1} or {UNKNOWN} (unknown), got {wrong}")
    if factor < 1 or any(size % factor for size in labels.shape[-3:]):
        raise ValueError(f"the last three axes must be multiples of factor {factor}, got shape {tuple(labels.shape)}")
    x, y, z = (size // factor for size in labels.shape[-3:])
    blocks = labels.reshape(-1, x, factor, y, factor, z, factor).permute(0, 1, 3, 5, 2, 4, 6).flatten(4)
    best = torch.zeros(blocks.shape[:-1], dtype=torch.int32, device=labels.device)
    for label in range(1, num_classes):
        votes = (blocks == label).sum(dim=-1, dtype=torch.int32)
        best = torch.maximum(best, torch.where(votes > 0, votes * 256 + label, 0))
    unknown = 2 * (blocks == UNKNOWN).sum(dim=-1) > factor**3
    joined = torch.where((best == 0) & unknown, UNKNOWN, best % 256)
    return joined.to(torch.uint8).reshape(*labels.shape[:-3], x, y, z)
