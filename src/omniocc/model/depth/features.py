"""The 2D feature network that all cameras share."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.model.depth.layers import UNet2d, norm

STRIDE = 2


class FeatureNet(nn.Module):
    """Images to feature maps at half their size, one network for all cameras.

    The stem covers 4x4 px around the centre of every 2x2 block, so that a feature stands exactly where `grid_sample`
    coordinates put it and mirrored images give mirrored places.

    Args:
        channels: of each level, finest first, the first at half the image size; multiples of 8.
        out_channels: of the result.
    """

    def __init__(self, channels: list[int], out_channels: int):
        super().__init__()
        self.stem = nn.Conv2d(3, channels[0], 4, stride=STRIDE, padding=1, bias=False)
        self.norm = norm(channels[0])
        self.net = UNet2d(channels, blocks=1, wrap=False)
        self.out = nn.Conv2d(channels[0], out_channels, 1)

    def forward(self, images: Float[Tensor, "B N 3 H W"]) -> Float[Tensor, "B N C _ _"]:
        """Features; the height and width of an image must be even.

        Raises:
            ValueError: if they are not.
        """
        if images.shape[-2] % STRIDE or images.shape[-1] % STRIDE:
            raise ValueError(f"images are {images.shape[-1]}x{images.shape[-2]} px; width and height must be even")
        flat = images.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        maps = self.net(torch.relu(self.norm(self.stem((flat - 0.45) / 0.25))))
        return self.out(maps).unflatten(0, images.shape[:2])
