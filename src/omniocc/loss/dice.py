"""Dice loss of voxels."""

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor, nn

from omniocc.loss.soft_confusion import soft_confusion


class Dice(nn.Module):
    """Mean over classes of 1 - 2 TP / (2 TP + FP + FN), with sums of probabilities as counts (paper, eq. 5).

    The paper does not state which classes count. Those that occur in the target do here, free included. A class that
    does not occur has TP = 0 for every prediction: its term would be 1 without a gradient.
    """

    def forward(self, logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, ""]:
        """Return a scalar; 0 if no voxel is known. Counts run over the whole batch."""
        confusion = soft_confusion(logits, target)
        count = confusion.sum(1)
        present = count > 0.5
        overlap = 2 * confusion.diagonal() / torch.where(present, confusion.sum(0) + count, 1)
        return torch.where(present, 1 - overlap, 0).sum() / present.sum().clamp(min=1)
