"""Lovász-softmax loss of voxels."""

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.classes import UNKNOWN


def jaccard_steps(foreground: Float32[Tensor, "C N"]) -> Float32[Tensor, "C N"]:
    """Return the increase of the Jaccard loss by each further wrong voxel, in the given order.

    For each row, with Delta_k = 1 - |y minus the first k| / |y or the first k| the Jaccard loss with the first k voxels
    wrong: Delta_k - Delta_(k-1), and Delta_0 = 0 (Berman et al. 2018, eq. 8 and 9). `foreground` is
    1 where a voxel belongs to the class, else 0, along the order.
    """
    count = foreground.sum(1, keepdim=True)
    missed = count - foreground.cumsum(1)
    union = count + (1 - foreground).cumsum(1)
    delta = 1 - missed / union
    return torch.cat([delta[:, :1], delta.diff(dim=1)], dim=1)


class Lovasz(nn.Module):
    """Lovász extension of the Jaccard loss (Berman et al. 2018): the mean over classes in the target, free included.

    Sets run over the known voxels of the whole batch. Computed in float32, also under autocast.
    """

    def forward(self, logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, ""]:
        """Return a scalar; 0 if no voxel is known."""
        with torch.autocast(logits.device.type, enabled=False):
            known = target.flatten() != UNKNOWN
            probability = F.softmax(logits.float().flatten(2), dim=1).transpose(0, 1).flatten(1)[:, known]
            labels = target.flatten()[known]
            if not len(labels):
                return probability.sum()
            classes = labels.unique().long()
            foreground = (labels == classes.unsqueeze(1)).float()
            errors, order = (foreground - probability[classes]).abs().sort(dim=1, descending=True)
            return (errors * jaccard_steps(foreground.gather(1, order))).sum(1).mean()
