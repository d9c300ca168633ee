"""Voxels look at the ends of the runs of equal class around them (in the style of FoSOcc's centre focusing module)."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import CountOrNone, Size
from omniocc.geometry import Grid
from omniocc.model.ops.multilinear import sum_samples
from omniocc.model.ops.norm import group_norm
from omniocc.model.ops.padding import Conv3d, Periodic
from omniocc.model.protocols import Extras, Sketched
from omniocc.model.refiner.conv import Conv

DIRECTIONS = 6
"""Up and down along the first axis, the second, the third."""
FIRST_LENGTH = 0.05
"""Run lengths before training, as fractions of each axis."""


class Focus(nn.Module):
    """Apply a residual pyramid, predict run lengths, and let every voxel attend to the ends of its six runs.

    In the style of FoSOcc (OccTrack360, arXiv 2603.08521, centre focusing module). The run length of a voxel in a
    direction is the number of voxels after it that have its class, here as a fraction of the axis's cells; runs wrap
    around on periodic axes. Seven features, of the voxel and of the ends of its runs, are averaged by softmax
    attention. `omniocc.loss.RunLengths` trains the lengths.

    Args:
        in_channels: of the input volume.
        channels: of each level of the pyramid, finest first; multiples of 8. The finest is that of the output.
        blocks: of each level.

    Raises:
        ValueError: as `Conv`.
    """

    def __init__(self, geometry: Grid, in_channels: Size, channels: list[Size], blocks: list[CountOrNone]):
        super().__init__()
        self.encoder = Conv(geometry, in_channels, channels, blocks)
        self.periodic, self.channels = geometry.periodic, channels[0]
        self.lengths = Conv3d(self.channels, DIRECTIONS, 3, self.periodic)
        assert self.lengths.bias is not None
        # the sigmoid of this bias is FIRST_LENGTH
        nn.init.constant_(self.lengths.bias, math.log(FIRST_LENGTH / (1 - FIRST_LENGTH)))
        self.attention = EndAttention(self.channels, self.periodic)

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B D X Y Z"]:
        """Refine a volume; the result has `channels` channels."""
        return self.with_extras(volume, sketched)[0]

    def with_extras(
        self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched
    ) -> tuple[Float[Tensor, "B D X Y Z"], Extras]:
        """Return the refined volume and the run lengths."""
        volume = self.encoder(volume, sketched)
        lengths = self.lengths(volume).sigmoid()
        return self.attention(volume, lengths), Extras(run_lengths=lengths)


class EndAttention(nn.Module):
    """Add to each voxel a mean of its own feature and those at the ends of its runs, with softmax weights.

    The weights are products of a query of the voxel and a key of each feature; query and key are one linear map. Keys
    have no bias, which would be the same for all seven.
    """

    def __init__(self, channels: int, periodic: Periodic):
        super().__init__()
        self.periodic = periodic
        self.query = nn.Linear(channels, channels)
        self.value = nn.Linear(channels, channels, bias=False)
        self.norm = group_norm(channels)

    def forward(
        self, volume: Float[Tensor, "B C X Y Z"], lengths: Float[Tensor, "B 6 X Y Z"]
    ) -> Float[Tensor, "B C X Y Z"]:
        """Return features of the same shape, none negative."""
        # bfloat16 has 8 significant bits: from cell 64 on it would round positions to half cells
        with torch.autocast(volume.device.type, enabled=False):
            wide = volume.to(torch.promote_types(volume.dtype, torch.float32))
            own = wide.movedim(1, -1)
            seven = [own, *end_features(wide, lengths.to(wide.dtype), self.periodic)]
            query = self.query(own) / math.sqrt(own.shape[-1])
            weights = torch.stack([(feature * query).sum(-1) for feature in seven]).softmax(0)
            mean = sum((feature * weight[..., None] for feature, weight in zip(seven, weights, strict=True)), 0)
            change = self.norm(self.value(mean).movedim(-1, 1))
            return F.relu(wide + change)


def end_features(
    volume: Float[Tensor, "B C X Y Z"], lengths: Float[Tensor, "B 6 X Y Z"], periodic: Periodic
) -> list[Float[Tensor, "B X Y Z C"]]:
    """Return the features at the ends of the runs in each direction: linear between two cells of the same line.

    The lengths are fractions of each axis's cells, in [0, 1]: up and down along the first axis, the second, the third.
    An end beyond the last cell of an axis that does not wrap around is that cell.
    """
    ends = []
    for axis, wraps in enumerate(periodic):
        cells = volume.shape[2 + axis]
        place = torch.arange(cells, dtype=lengths.dtype, device=lengths.device)
        place = place.view([-1 if other == axis else 1 for other in range(3)])
        for direction, sign in enumerate((1, -1)):
            position = place + sign * cells * lengths[:, 2 * axis + direction]
            ends.append(along_axis(volume, position, axis, wraps))
    return ends


def along_axis(
    volume: Float[Tensor, "B C X Y Z"], position: Float[Tensor, "B X Y Z"], axis: int, wraps: bool
) -> Float[Tensor, "B X Y Z C"]:
    """Return, for every voxel, the feature at a position (in cells) on the line through it along an axis."""
    cells, channels = volume.shape[2 + axis], volume.shape[1]
    # one more cell at the upper end, so that every sample has two corners a constant step apart
    more = volume.narrow(2 + axis, 0 if wraps else cells - 1, 1)
    padded = torch.cat([volume, more], dim=2 + axis).movedim(1, -1)
    position = position.remainder(cells) if wraps else position.clamp(0, cells - 1)
    lower = position.detach().floor().clamp(0, cells - 1)
    fraction = position - lower
    rows = torch.arange(padded[..., 0].numel(), dtype=torch.int32, device=volume.device).view(padded.shape[:-1])
    step = math.prod(padded.shape[axis + 2 : -1])
    # a nan position has a valid row and nan weights
    row = rows.narrow(1 + axis, 0, 1) + lower.int().clamp(0, cells - 1) * step
    weights = torch.stack([1 - fraction, fraction], dim=-1)
    samples = sum_samples(padded.reshape(-1, channels), row.view(-1, 1), weights.view(-1, 1, 2), (0, step))
    return samples.view(*position.shape, channels)
