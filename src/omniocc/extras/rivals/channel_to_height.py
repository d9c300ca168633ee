"""Two-dimensional reasoning on the bird's-eye view, whose channels become heights (FlashOcc)."""

from itertools import pairwise

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import CountOrNone, Size
from omniocc.geometry import Grid
from omniocc.model.ops.norm import group_norm
from omniocc.model.ops.padding import Periodic, ResidualPair, check_halvings, pad3d, upsample_view
from omniocc.model.protocols import Sketched


class ViewConv(nn.Conv2d):
    """Convolve a view by 3x3 kernels without bias, keeping its size and wrapping around on periodic axes."""

    def __init__(self, channels: int, periodic: Periodic):
        super().__init__(channels, channels, 3, bias=False)
        self.periodic = periodic

    def forward(self, view: Float[Tensor, "B C X Y"]) -> Float[Tensor, "B C X Y"]:
        """Return the convolved view."""
        return super().forward(pad3d(view.unsqueeze(-1), (1, 1, 0), self.periodic).squeeze(-1))


def view_block(channels: int, periodic: Periodic) -> ResidualPair:
    """Return a residual block of two convolutions."""
    return ResidualPair(ViewConv(channels, periodic), ViewConv(channels, periodic))


class ChannelToHeight(nn.Module):
    """Turn columns of voxels into channels, apply residual blocks on a pyramid of halved views, and turn them back.

    FlashOcc (Yu et al., 2023) replaces the 3D convolutions of BEVDet's occupancy version in this way: only the linear
    maps at both ends depend on the height. Levels are merged as in `Conv`.

    Args:
        in_channels: of the input volume.
        channels: of the output volume.
        view_channels: of each level, finest first; multiples of 8.
        blocks: of each level.

    Raises:
        ValueError: if channels, blocks and periodic axes do not fit together.
    """

    def __init__(
        self, geometry: Grid, in_channels: Size, channels: Size, view_channels: list[Size], blocks: list[CountOrNone]
    ):
        super().__init__()
        if len(view_channels) != len(blocks) or not blocks:
            raise ValueError(f"channels {view_channels} and blocks {blocks} must be one number each for every level")
        check_halvings(geometry, len(blocks))
        self.periodic = geometry.periodic
        self.channels = channels
        self.fold = nn.Linear(geometry.shape[2] * in_channels, view_channels[0])
        self.down = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairwise(view_channels))
        self.stages = nn.ModuleList(
            nn.Sequential(*(view_block(width, self.periodic) for _ in range(count)))
            for width, count in zip(view_channels, blocks, strict=True)
        )
        self.merge = nn.ModuleList(nn.Conv2d(own, view_channels[0], 1) for own in view_channels)
        self.norm = group_norm(view_channels[0])
        self.unfold = nn.Linear(view_channels[0], geometry.shape[2] * channels)

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B D X Y Z"]:
        """Refine a volume; the result has `channels` channels."""
        view = self.fold(volume.movedim(1, -1).flatten(-2)).movedim(-1, 1)
        levels = [self.stages[0](view)]
        for down, stage in zip(self.down, self.stages[1:], strict=True):
            # an odd axis gets a zero cell at its upper end
            odd = [cells for size in reversed(levels[-1].shape[2:]) for cells in (0, size % 2)]
            levels.append(stage(down(F.pad(levels[-1], odd))))
        merged = self.merge[-1](levels[-1])
        for level, merge in reversed(list(zip(levels[:-1], self.merge[:-1], strict=True))):
            merged = merge(level) + upsample_view(merged, level.shape[2:], self.periodic[:2])
        columns = self.unfold(F.relu(self.norm(merged)).movedim(1, -1))
        return columns.unflatten(-1, (volume.shape[-1], -1)).movedim(-1, 1)
