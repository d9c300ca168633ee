"""3D residual encoder and feature pyramid (the occupancy version of BEVDet)."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import CountOrNone, Size
from omniocc.geometry import Grid
from omniocc.model.ops.norm import group_norm
from omniocc.model.ops.padding import Conv3d, Downsample, Periodic, Pointwise, ResidualPair, check_halvings, upsample
from omniocc.model.protocols import Sketched


def block(channels: int, periodic: Periodic) -> ResidualPair:
    """Return a residual block of two 3x3x3 convolutions."""
    return ResidualPair(*(Conv3d(channels, channels, 3, periodic, bias=False) for _ in range(2)))


class Conv(nn.Module):
    """Apply residual blocks on a pyramid of halved grids, whose levels are merged at the finest, without a decoder.

    As in BEVDet's occupancy version (Huang et al., 2021). There the levels are upsampled, concatenated and mixed by a
    1x1x1 convolution; mixing first and adding after upsampling is the same and cheaper. With one level it is a few
    convolutions, as in the occupancy head of BEVFormer (Li et al., 2022).

    Args:
        in_channels: of the input volume.
        channels: of each level, finest first; multiples of 8. The finest is that of the output.
        blocks: of each level.

    Raises:
        ValueError: if channels, blocks and periodic axes do not fit together.
    """

    def __init__(self, geometry: Grid, in_channels: Size, channels: list[Size], blocks: list[CountOrNone]):
        super().__init__()
        if len(channels) != len(blocks) or not channels:
            raise ValueError(f"channels {channels} and blocks {blocks} must be one number each for every level")
        check_halvings(geometry, len(channels))
        self.periodic = geometry.periodic
        self.channels = channels[0]
        self.stem = Pointwise(in_channels, channels[0])
        self.down = nn.ModuleList(Downsample(fine, coarse, self.periodic) for fine, coarse in pairwise(channels))
        self.stages = nn.ModuleList(
            nn.Sequential(*(block(width, self.periodic) for _ in range(count)))
            for width, count in zip(channels, blocks, strict=True)
        )
        self.merge = nn.ModuleList(Pointwise(own, channels[0]) for own in channels)
        self.norm = group_norm(channels[0])

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B D X Y Z"]:
        """Refine a volume; the result has `channels` channels."""
        # channels last: 3D convolutions run about a third faster on the CPU
        volume = self.stages[0](self.stem(volume.contiguous(memory_format=torch.channels_last_3d)))
        levels = [volume]
        for down, stage in zip(self.down, self.stages[1:], strict=True):
            levels.append(stage(down(levels[-1])))
        merged = self.merge[-1](levels[-1])
        for level, merge in reversed(list(zip(levels[:-1], self.merge[:-1], strict=True))):
            merged = merge(level) + upsample(merged, level.shape[2:], self.periodic)  # type: ignore[arg-type]
        return F.relu(self.norm(merged))
