"""A 3D encoder-decoder on halved grids with added skips, whatever its blocks are."""

from collections.abc import Callable
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.geometry import Grid
from omniocc.model.ops.padding import Downsample, Periodic, Pointwise, check_halvings, upsample

Block = Callable[[int, Periodic], nn.Module]
"""Makes a network that keeps the size of a volume, from its channels and the axes that wrap around."""


class Pyramid(nn.Module):
    """Hold the layers of an encoder-decoder; the finest level has a block only on the way up.

    Args:
        in_channels: of the input volume.
        channels: of each level, finest first; multiples of 8. The finest is that of the output.
        block: makes the block of a level.

    Raises:
        ValueError: if a periodic axis cannot be halved often enough, or the channels do not split into groups.
    """

    def __init__(self, geometry: Grid, in_channels: int, channels: list[int], block: Block):
        super().__init__()
        check_halvings(geometry, len(channels))
        self.periodic = geometry.periodic
        self.channels = channels[0]
        pairs = list(pairwise(channels))
        self.stem = Pointwise(in_channels, channels[0])
        self.down = nn.ModuleList(Downsample(fine, coarse, self.periodic) for fine, coarse in pairs)
        self.encoder = nn.ModuleList(block(coarse, self.periodic) for _, coarse in pairs)
        self.up = nn.ModuleList(Pointwise(coarse, fine) for fine, coarse in pairs)
        self.decoder = nn.ModuleList(block(fine, self.periodic) for fine, _ in pairs)

    def levels(self, volume: Float[Tensor, "B C X Y Z"]) -> list[Float[Tensor, "B _ _ _ _"]]:
        """Return the volumes of all levels after the way up, coarsest first."""
        # channels last: 3D convolutions run about a third faster on the CPU
        volume = self.stem(volume.contiguous(memory_format=torch.channels_last_3d))
        skips = []
        for down, block in zip(self.down, self.encoder, strict=True):
            skips.append(volume)
            volume = block(down(volume))
        levels = [volume]
        for up, block, skip in reversed(list(zip(self.up, self.decoder, skips, strict=True))):
            levels.append(block(skip + upsample(up(levels[-1]), skip.shape[2:], self.periodic)))
        return levels
