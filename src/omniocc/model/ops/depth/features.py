"""The 2D feature network of all cameras."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.model.ops.depth.layers import UNet2d
from omniocc.model.ops.norm import group_norm

STRIDE = 2


class FeatureNet(nn.Module):
    """Extract features at half the size of the images, by one network for all cameras.

    The stem covers 4x4 px around the centre of every 2x2 block, so that features are exactly at their `grid_sample`
    coordinates, and mirrored images give mirrored features.

    Args:
        channels: of each level, finest first, the first at half the image size; multiples of 8.
        extra_channels: of input maps besides the colours.
    """

    def __init__(self, channels: list[int], out_channels: int, extra_channels: int = 0):
        super().__init__()
        self.stem = nn.Conv2d(3 + extra_channels, channels[0], 4, stride=STRIDE, padding=1, bias=False)
        self.norm = group_norm(channels[0])
        self.net = UNet2d(channels, blocks=1, wrap=False)
        self.out = nn.Conv2d(channels[0], out_channels, 1)

    def forward(
        self, images: Float[Tensor, "B N 3 H W"], extra: Float[Tensor, "B N E H W"] | None = None
    ) -> Float[Tensor, "B N C _ _"]:
        """Return features of images; raise ValueError unless their height and width are even."""
        if images.shape[-2] % STRIDE or images.shape[-1] % STRIDE:
            raise ValueError(f"images are {images.shape[-1]}x{images.shape[-2]} px; width and height must be even")
        colors = (images - 0.45) / 0.25
        inputs = colors if extra is None else torch.cat([colors, extra], 2)
        flat = inputs.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        maps = self.net(torch.relu(self.norm(self.stem(flat))))
        return self.out(maps).unflatten(0, images.shape[:2])
