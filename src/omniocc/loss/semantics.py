"""Cross-entropy of pixels, for the 2D head that is used in training only."""

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.classes import UNKNOWN


def labels_at(labels: UInt8[Tensor, "*batch H W"], height: int, width: int) -> UInt8[Tensor, "*batch h w"]:
    """Return the label of the pixel at each cell centre of a height x width division of the image."""
    rows = ((torch.arange(height, device=labels.device) + 0.5) * labels.shape[-2] / height).long()
    columns = ((torch.arange(width, device=labels.device) + 0.5) * labels.shape[-1] / width).long()
    return labels[..., rows[:, None], columns]


class Semantics(nn.Module):
    """Mean cross-entropy over known pixels, at the resolution of the logits.

    Labels are read at the logits' cell centres. Upsampling the logits instead needs stride^2 times the memory and
    compares a bilinear mixture with every pixel of a cell, without more information in the features.
    """

    def forward(self, logits: Float[Tensor, "B N C h w"], labels: UInt8[Tensor, "B N H W"]) -> Float32[Tensor, ""]:
        """Return a scalar; 0 if no pixel is known."""
        target = labels_at(labels, logits.shape[-2], logits.shape[-1]).flatten(0, 1).long()
        loss = F.cross_entropy(logits.flatten(0, 1).float(), target, ignore_index=UNKNOWN, reduction="sum")
        return loss / (target != UNKNOWN).sum().clamp(min=1)
