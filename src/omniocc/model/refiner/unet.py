"""3D encoder-decoder with skips (paper, section IV-F)."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.geometry import Grid
from omniocc.model.ops.norm import check_halvings
from omniocc.model.ops.padding import Downsample, Pointwise, residual3d, upsample
from omniocc.model.protocols import Sketched


class UNet(nn.Module):
    """Apply residual blocks on a pyramid of halved grids with added skips; wraps around on the grid's periodic axes.

    The finest level, the most expensive one, has a block only on the way up. Rolling the input
    along a periodic axis by a multiple of 2**(levels-1) cells rolls the output.

    Args:
        channels: of each level, finest first; multiples of 8. The finest is that of the output.

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
        self.encoder = nn.ModuleList(residual3d(coarse, self.periodic) for _, coarse in pairs)
        self.up = nn.ModuleList(Pointwise(coarse, fine) for fine, coarse in pairs)
        self.decoder = nn.ModuleList(residual3d(fine, self.periodic) for fine, _ in pairs)

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B D X Y Z"]:
        """Refine a volume; the result has `channels` channels."""
        # channels last: 3D convolutions run about a third faster on the CPU
        volume = self.stem(volume.contiguous(memory_format=torch.channels_last_3d))
        skips = []
        for down, block in zip(self.down, self.encoder, strict=True):
            skips.append(volume)
            volume = block(down(volume))
        for up, block, skip in reversed(list(zip(self.up, self.decoder, skips, strict=True))):
            volume = block(skip + upsample(up(volume), skip.shape[2:], self.periodic))
        return volume
