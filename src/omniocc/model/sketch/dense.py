"""Every voxel is a candidate."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.geometry import Grid
from omniocc.model.ops.padded import Rigs
from omniocc.model.protocols import Sketched


class Dense(nn.Module):
    """Choose the whole grid, as in methods without a sketch."""

    def __init__(self, geometry: Grid):
        super().__init__()
        self.geometry = geometry

    def forward(
        self, images: Float[Tensor, "B N 3 H W"], rigs: Rigs, true_range_m: Float[Tensor, "B h w"] | None = None
    ) -> Sketched:
        """Return every voxel."""
        return Sketched(torch.ones(len(images), *self.geometry.shape, dtype=torch.bool, device=images.device))
