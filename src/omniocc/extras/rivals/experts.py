"""3D encoder-decoder of depthwise convolutions and gated pointwise experts (in the style of OneOcc)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Count, Size
from omniocc.geometry import Grid
from omniocc.model.ops.norm import group_norm
from omniocc.model.ops.padding import Periodic, Pointwise, pad3d
from omniocc.model.ops.pyramid import Pyramid
from omniocc.model.protocols import CoarseLogits, Extras, Sketched

SQUEEZE = 4
"""Channels per hidden channel of the channel gate."""


class Experts(Pyramid):
    """Apply blocks of a depthwise convolution and gated experts on a pyramid, and classify its coarser levels too.

    In the style of OneOcc (arXiv 2511.03571): a depthwise-separable 3D UNet whose pointwise layers are mixtures of
    experts, supervised at every level. Rolling the input along a periodic axis by a multiple of 2**(levels-1) cells
    rolls the output.

    Args:
        in_channels: of the input volume.
        channels: of each level, finest first; multiples of 8. The finest is that of the output.
        experts: linear maps that every voxel's features are mixed from.
        num_classes: of the blocks of the coarser levels, free included.

    Raises:
        ValueError: if there is no expert, a periodic axis cannot be halved often enough, or the channels do not split
            into groups.
    """

    def __init__(self, geometry: Grid, in_channels: Size, channels: list[Size], experts: Count, num_classes: Size):
        if experts < 1:
            raise ValueError(f"experts is {experts}; at least one is needed")
        super().__init__(geometry, in_channels, channels, lambda width, periodic: ExpertBlock(width, periodic, experts))
        self.classifiers = nn.ModuleList(Pointwise(width, num_classes) for width in reversed(channels[1:]))

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B D X Y Z"]:
        """Refine a volume; the result has `channels` channels."""
        return self.levels(volume)[-1]

    def with_extras(
        self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched
    ) -> tuple[Float[Tensor, "B D X Y Z"], Extras]:
        """Return the refined volume, and logits of blocks of 2, 4, ... cells, coarsest first."""
        *coarse, fine = self.levels(volume)
        levels = enumerate(zip(self.classifiers, coarse, strict=True))
        return fine, Extras(
            tuple(CoarseLogits(2 ** (len(coarse) - index), classify(level)) for index, (classify, level) in levels)
        )


class ExpertBlock(nn.Module):
    """Compute x + relu(norm(sum over experts of gate * map(gates(depthwise(x))))).

    A depthwise convolution is scaled by a gate of each channel, from its mean over the volume, and a gate of each
    voxel, from its mean and largest channel. Each voxel weighs the experts by a softmax of the energy of the input's
    gradient there, so that surfaces and the inside of volumes are served by different experts.
    """

    def __init__(self, channels: int, periodic: Periodic, experts: int):
        super().__init__()
        self.depthwise = Depthwise3d(channels, periodic)
        hidden = max(channels // SQUEEZE, 1)
        self.channel_gate = nn.Sequential(nn.Linear(channels, hidden), nn.SiLU(), nn.Linear(hidden, channels))
        self.place_gate = nn.Linear(2, 1)
        self.choice = nn.Linear(3, experts)
        self.experts = nn.Linear(channels, experts * channels)
        self.norm = group_norm(channels)
        self.periodic = periodic

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        """Return a volume of the same size."""
        choice = self.choice(gradient_energy(volume, self.periodic).movedim(1, -1)).softmax(-1)
        spread = self.depthwise(volume)
        channel = self.channel_gate(spread.mean((2, 3, 4))).sigmoid()
        rows = spread.movedim(1, -1) * channel[:, None, None, None]
        place = self.place_gate(torch.stack([rows.mean(-1), rows.amax(-1)], dim=-1)).sigmoid()
        mapped = self.experts(rows * place).unflatten(-1, (choice.shape[-1], -1))
        mixed = (mapped * choice.unsqueeze(-1)).sum(-2)
        return volume + F.relu(self.norm(mixed.movedim(-1, 1)))


def gradient_energy(volume: Float[Tensor, "B C X Y Z"], periodic: Periodic) -> Float[Tensor, "B 3 X Y Z"]:
    """Return log(1 + mean over channels of the squared central difference) along each axis; zeros beyond open ends."""
    energies = []
    for axis in range(3):
        size = volume.shape[2 + axis]
        ends = tuple(int(other == axis) for other in range(3))
        padded = pad3d(volume, ends, periodic)  # type: ignore[arg-type]
        difference = (padded.narrow(2 + axis, 2, size) - padded.narrow(2 + axis, 0, size)) / 2
        energies.append(difference.square().mean(1))
    return torch.stack(energies, dim=1).log1p()


class Depthwise3d(nn.Conv3d):
    """Convolve every channel by its own 3x3x3 kernel, wrapping around on periodic axes."""

    def __init__(self, channels: int, periodic: Periodic):
        super().__init__(channels, channels, 3, groups=channels, bias=False)
        self.periodic = periodic

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        """Return the convolved volume."""
        return super().forward(pad3d(volume, (1, 1, 1), self.periodic))
