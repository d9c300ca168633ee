"""Normalisation for networks trained on ImageNet."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


class Normalize(nn.Module):
    """Normalise RGB in [0, 1] to the mean 0 and deviation 1 of ImageNet."""

    mean: Tensor
    std: Tensor

    def __init__(self):
        super().__init__()
        self.register_buffer("mean", torch.tensor(MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(STD).view(3, 1, 1), persistent=False)

    def forward(self, images: Float[Tensor, "B N 3 H W"]) -> Float[Tensor, "BN 3 H W"]:
        """Return images of all cameras as one batch, channels last in memory."""
        return ((images - self.mean) / self.std).flatten(0, 1).contiguous(memory_format=torch.channels_last)
