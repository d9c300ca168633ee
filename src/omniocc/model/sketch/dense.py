"""Every voxel is a candidate."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.geometry import Grid


class Dense(nn.Module):
    """The whole grid, as in methods without a sketch.

    Args:
        geometry: the voxel grid.
    """

    def __init__(self, geometry: Grid):
        super().__init__()
        self.geometry = geometry

    def forward(self, images: Float[Tensor, "B N 3 H W"], rigs: tuple[Rig, ...]) -> Bool[Tensor, "B X Y Z"]:
        """All true."""
        return torch.ones(len(images), *self.geometry.shape, dtype=torch.bool, device=images.device)
