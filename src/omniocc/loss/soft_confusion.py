"""Soft confusion matrix: the sufficient statistics of the scene-wide losses."""

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor
from torch.nn import functional as F

from omniocc.classes import UNKNOWN


def soft_confusion(logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, "C C"]:
    """Return the probability mass by true (row) and predicted (column) class, summed over the known voxels.

    Later sums add entries of this matrix without subtraction, so that they stay exact where a probability is close to
    0 or 1. The sum of a row is the number of voxels of the class but for rounding, so a class occurs where it is above
    0.5. Computed in float32, also under autocast.
    """
    classes = logits.shape[1]
    with torch.autocast(logits.device.type, enabled=False):
        probability = F.softmax(logits.float().flatten(2), dim=1)
        labels = target.flatten(1)
        ids = torch.arange(classes, dtype=torch.uint8, device=target.device)
        one_hot = (labels[:, None] == ids[:, None]).float()  # UNKNOWN equals no id: its rows are 0
        assert classes <= UNKNOWN
        return torch.bmm(one_hot, probability.transpose(1, 2)).sum(0)


def log_ratio(part: Float32[Tensor, "*batch"], whole: Float32[Tensor, "*batch"]) -> Float32[Tensor, "*batch"]:
    """Return log(part / whole) for part <= whole; finite, with 0 / 0 = 1."""
    tiny = torch.finfo(part.dtype).tiny
    return part.clamp(min=tiny).log() - whole.clamp(min=tiny).log()
