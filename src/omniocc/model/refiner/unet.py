"""3D encoder-decoder with skips (paper, section IV-F)."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.geometry import Grid
from omniocc.model.ops.padding import Conv3d, Downsample, Periodic, Pointwise, upsample
from omniocc.model.protocols import Sketched

GROUP_CHANNELS = 8


def group_norm(channels: int) -> nn.GroupNorm:
    """Normalises each sample on its own, so that a batch of two is two batches of one.

    Raises:
        ValueError: if the channels do not split into groups.
    """
    if channels % GROUP_CHANNELS:
        raise ValueError(f"{channels} channels; every level needs a multiple of {GROUP_CHANNELS}")
    return nn.GroupNorm(channels // GROUP_CHANNELS, channels)


def check_halvings(geometry: Grid, levels: int) -> None:
    """Periodic axes must halve evenly from level to level, or what wraps around would not meet itself.

    Raises:
        ValueError: naming the axis's cells and the multiple they need.
    """
    factor = 2 ** (levels - 1)
    for cells, wraps in zip(geometry.shape, geometry.periodic, strict=True):
        if wraps and cells % factor:
            raise ValueError(
                f"{levels} levels need a periodic axis in multiples of {factor} cells, not {cells}; "
                "change the grid or give fewer channels"
            )


class Residual(nn.Module):
    """x + relu(norm(conv(x)))."""

    def __init__(self, channels: int, periodic: Periodic):
        super().__init__()
        self.conv = Conv3d(channels, channels, 3, periodic, bias=False)
        self.norm = group_norm(channels)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        """A volume of the same size."""
        return volume + F.relu(self.norm(self.conv(volume)))


class UNet(nn.Module):
    """Residual blocks on a pyramid of halved grids; skips are added. Wraps around on the grid's periodic axes.

    The finest level, where a block costs as much as all others together, has one on the way up only. Rolling the input
    along a periodic axis by a multiple of 2**(levels-1) cells rolls the output.

    Args:
        geometry: the voxel grid.
        in_channels: of the lifted volume.
        channels: of each level, finest first; multiples of 8. The finest is what comes out.

    Raises:
        ValueError: if a periodic axis cannot be halved often enough, or the channels do not split into groups.
    """

    def __init__(self, geometry: Grid, in_channels: int, channels: list[int]):
        super().__init__()
        check_halvings(geometry, len(channels))
        self.periodic = geometry.periodic
        self.channels = channels[0]
        pairs = list(pairwise(channels))
        self.stem = Pointwise(in_channels, channels[0])
        self.down = nn.ModuleList(Downsample(fine, coarse, self.periodic) for fine, coarse in pairs)
        self.encoder = nn.ModuleList(Residual(coarse, self.periodic) for _, coarse in pairs)
        self.up = nn.ModuleList(Pointwise(coarse, fine) for fine, coarse in pairs)
        self.decoder = nn.ModuleList(Residual(fine, self.periodic) for fine, _ in pairs)

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B D X Y Z"]:
        """Refine a volume; the result has `channels` channels."""
        # channels last: 3D convolutions run about a third faster on the CPU
        volume = self.stem(volume.contiguous(memory_format=torch.channels_last_3d))
        skips = []
        for down, block in zip(self.down, self.encoder, strict=True):
            skips.append(volume)
            volume = block(down(volume))
        for up, block in reversed(list(zip(self.up, self.decoder, strict=True))):
            skip = skips.pop()
            volume = block(skip + upsample(up(volume), skip.shape[2:], self.periodic))
        return volume
