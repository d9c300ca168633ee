"""3D network in the manner of Cylinder3D (Zhu et al. 2021), on dense volumes.

Dense convolutions need no compiled library, and can complete parts that the panorama does not see, which sparse ones on
active sites cannot. The mask of cells with points is an input.
"""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.geometry import Grid
from omniocc.model.ops.norm import group_norm
from omniocc.model.ops.padding import Axes, Conv3d, Downsample, Periodic, Pointwise, check_halvings, upsample

ACROSS_SECOND: Axes = (3, 1, 3)
ACROSS_FIRST: Axes = (1, 3, 3)


class ConvNorm(nn.Module):
    """Apply convolution, leaky ReLU and norm, in the order of Cylinder3D."""

    def __init__(self, in_channels: int, out_channels: int, kernel: Axes, periodic: Periodic):
        super().__init__()
        self.conv = Conv3d(in_channels, out_channels, kernel, periodic)
        self.norm = group_norm(out_channels)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """Return a volume of the same size."""
        return self.norm(F.leaky_relu(self.conv(volume)))


class Asymmetric(nn.Module):
    """Apply an asymmetric residual block: the sum of kernels 3x1x3 then 1x3x3, and 1x3x3 then 3x1x3."""

    def __init__(self, in_channels: int, out_channels: int, periodic: Periodic):
        super().__init__()

        def branch(first: Axes, second: Axes) -> nn.Sequential:
            return nn.Sequential(
                ConvNorm(in_channels, out_channels, first, periodic),
                ConvNorm(out_channels, out_channels, second, periodic),
            )

        self.first = branch(ACROSS_SECOND, ACROSS_FIRST)
        self.second = branch(ACROSS_FIRST, ACROSS_SECOND)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """Return a volume of the same size."""
        return self.first(volume) + self.second(volume)


class Context(nn.Module):
    """Weight the volume by the sum of three gates along one axis each (dimension-decomposed context)."""

    def __init__(self, channels: int, periodic: Periodic):
        super().__init__()
        kernels: list[Axes] = [(3, 1, 1), (1, 3, 1), (1, 1, 3)]
        self.convs = nn.ModuleList(Conv3d(channels, channels, kernel, periodic) for kernel in kernels)
        self.norms = nn.ModuleList(group_norm(channels) for _ in kernels)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        """Return a volume of the same size."""
        gates = [norm(conv(volume)).sigmoid() for conv, norm in zip(self.convs, self.norms, strict=True)]
        return volume * sum(gates[1:], gates[0])


class Cylinder3D(nn.Module):
    """Apply asymmetric blocks on a pyramid of halved grids, then context; wraps around on the grid's periodic axes.

    Rolling the input along a periodic axis by a multiple of 2**(levels-1) cells rolls the output.

    Args:
        in_channels: of the input volume.
        channels: of each level, finest first; multiples of 8.
        out_channels: of the output volume.

    Raises:
        ValueError: if a periodic axis cannot be halved often enough, or the channels do not split into groups.
    """

    def __init__(self, geometry: Grid, in_channels: int, channels: list[int], out_channels: int):
        super().__init__()
        check_halvings(geometry, len(channels))
        periodic = self.periodic = geometry.periodic
        pairs = list(pairwise(channels))
        self.stem = Asymmetric(in_channels, channels[0], periodic)
        self.down = nn.ModuleList(Downsample(fine, coarse, periodic) for fine, coarse in pairs)
        self.encoder = nn.ModuleList(Asymmetric(coarse, coarse, periodic) for _, coarse in pairs)
        self.up = nn.ModuleList(Pointwise(coarse, fine) for fine, coarse in pairs)
        self.decoder = nn.ModuleList(Asymmetric(fine, fine, periodic) for fine, _ in pairs[1:])
        self.context = Context(channels[0], periodic)
        self.out = Conv3d(2 * channels[0], out_channels, 3, periodic)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """Return logits of every cell."""
        # channels last: 3D convolutions run about a third faster on the CPU
        volume = self.stem(volume.contiguous(memory_format=torch.channels_last_3d))
        skips = []
        for down, block in zip(self.down, self.encoder, strict=True):
            skips.append(volume)
            volume = down(volume)
            volume = volume + block(volume)
        for level in reversed(range(len(self.up))):
            skip = skips.pop()
            volume = skip + upsample(self.up[level](volume), skip.shape[2:], self.periodic)
            if level:
                volume = volume + self.decoder[level - 1](volume)
        return self.out(torch.cat([self.context(volume), volume], dim=1))
