"""Weighted cross-entropy of voxels."""

import torch
from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Size
from omniocc.classes import UNKNOWN


def class_weights(counts: Int64[Tensor, " C"], constant: float) -> Float32[Tensor, " C"]:
    """Return w_c = 1 / log(f_c + constant), with f_c the fraction of class c among the known voxels (paper, eq. 4).

    The paper gives neither f_c nor the constant. In MonoScene, the source of the formula, f_c is the number of voxels
    and the constant 0.001: weights then depend on the size of the dataset, and that of a class that never occurs is
    negative. With fractions and a constant above 1 all weights are positive and finite; 2 keeps them in 0.91 to 1.44.
    """
    fraction = counts.double() / counts.sum().clamp(min=1)
    return (fraction + constant).log().reciprocal().float()


class CrossEntropy(nn.Module):
    """Cross-entropy weighted by class frequency: sum of w * loss / sum of w over the known voxels of the batch.

    All weights are 1 until `set_class_counts` is called; they are part of the state dict.

    Args:
        constant: c in w = 1 / log(f + c), above 1.
        num_classes: C.

    Raises:
        ValueError: if `constant` is not above 1.
    """

    weights: Tensor

    def __init__(self, constant: float, num_classes: Size):
        super().__init__()
        if constant <= 1:
            raise ValueError(f"constant is {constant}; above 1 all weights 1/log(fraction + constant) are positive")
        self.constant = constant
        self.register_buffer("weights", torch.ones(num_classes))

    def set_class_counts(self, counts: Int64[Tensor, " C"]) -> None:
        """Set the weights from the number of training voxels of each class."""
        self.weights.copy_(class_weights(counts, self.constant))

    def forward(self, logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, ""]:
        """Return a scalar; 0 if no voxel is known."""
        labels = target.long()
        loss = F.cross_entropy(logits.float(), labels, self.weights, ignore_index=UNKNOWN, reduction="sum")
        padded = F.pad(self.weights, (0, UNKNOWN + 1 - len(self.weights)))
        total = padded[labels].sum()
        # 0 / 0 where no voxel is known would be nan
        return loss / total.clamp(min=torch.finfo(total.dtype).tiny)
