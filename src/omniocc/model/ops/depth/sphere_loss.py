"""Losses of networks that choose among spheres."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from omniocc.model.ops.depth.depth_map import SKY_INDEX
from omniocc.model.ops.depth.spheres import Spheres


def two_hot_cross_entropy(logits: Float[Tensor, "B D h w"], index: Float[Tensor, "B h w"]) -> Float[Tensor, "B h w"]:
    """Return the cross-entropy with the two spheres beside `index`, weighted so that their mean is `index`."""
    log_p = logits.float().log_softmax(1)
    lower = index.floor().clamp(max=logits.shape[1] - 2)
    fraction = index - lower
    spheres = torch.stack([lower, lower + 1], 1).long()
    near = log_p.gather(1, spheres)
    return -((1 - fraction) * near[:, 0] + fraction * near[:, 1])


def _mean(values: Float[Tensor, "B h w"], counted: Bool[Tensor, "B h w"]) -> Float[Tensor, ""]:
    return torch.where(counted, values, 0).sum() / counted.sum().clamp(min=1)


@dataclass(frozen=True)
class SphereLoss:
    """Compute losses of index, log range and spheres where there is a surface, and of sky against surface.

    Smooth L1 of the index (weight 1) and of the log of the range, and cross-entropy over spheres, are means over pixels
    nearer than `SKY_INDEX`; the cross-entropy of sky or surface is a mean over all known pixels.
    """

    log_range_weight: float
    entropy_weight: float
    sky_weight: float

    def __call__(
        self,
        logits: Float[Tensor, "B D h w"],
        index: Float[Tensor, "B h w"],
        true_range_m: Float[Tensor, "B h w"],
        spheres: Spheres,
    ) -> dict[str, Float[Tensor, ""]]:
        """Return the losses `index`, `log_range`, `spheres` and `sky`.

        Args:
            logits: of the spheres and, last, of the sky.
            index: predicted.
            true_range_m: inf for the sky; nan does not count.
            spheres: meaning of the indices.
        """
        known = ~true_range_m.isnan()
        true = spheres.index(torch.where(known, true_range_m, torch.inf)).clamp(max=spheres.count - 1)
        near = known & (true > SKY_INDEX)
        sky = F.binary_cross_entropy_with_logits(logits[:, -1].float(), (~near).float(), reduction="none")
        ratio = (index.clamp(min=SKY_INDEX) / true.clamp(min=SKY_INDEX)).log()
        log_range = F.smooth_l1_loss(ratio, 0 * ratio, beta=0.05, reduction="none")
        return {
            "index": _mean(F.smooth_l1_loss(index, true, reduction="none"), near),
            "log_range": self.log_range_weight * _mean(log_range, near),
            "spheres": self.entropy_weight * _mean(two_hot_cross_entropy(logits[:, :-1], true), near),
            "sky": self.sky_weight * _mean(sky, known),
        }
