"""Dice loss of voxels."""

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor, nn

from omniocc.loss.soft_confusion import soft_confusion


class Dice(nn.Module):
    """1 - 2 TP / (2 TP + FP + FN) with probabilities for counts (paper, eq. 5), the mean over classes.

    The paper leaves open which classes count. Ours: those that occur in the target, free included. A class that does
    not occur has TP = 0 whatever is predicted: its term would be 1 with no gradient.
    """

    def forward(self, logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, ""]:
        """Scalar; 0 if no voxel is known. Counts run over the whole batch."""
        confusion = soft_confusion(logits, target)
        count = confusion.sum(1)
        present = count > 0.5
        overlap = 2 * confusion.diagonal() / torch.where(present, confusion.sum(0) + count, 1)
        return torch.where(present, 1 - overlap, 0).sum() / present.sum().clamp(min=1)
