"""Two-dimensional reasoning on the bird's-eye view, whose channels become heights (FlashOcc)."""

from itertools import pairwise

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.geometry import Grid
from omniocc.model.ops.norm import check_halvings, group_norm
from omniocc.model.ops.padding import Periodic, pad3d, upsample_view
from omniocc.model.protocols import Sketched


def pad_view(view: Float[Tensor, "B C X Y"], periodic: Periodic) -> Float[Tensor, "B C _ _"]:
    """Add one cell at both ends of both axes: the other end's where periodic, zeros elsewhere."""
    return pad3d(view.unsqueeze(-1), (1, 1, 0), periodic).squeeze(-1)


class ViewBlock(nn.Module):
    """Compute relu(x + norm(conv(relu(norm(conv(x))))))."""

    def __init__(self, channels: int, periodic: Periodic):
        super().__init__()
        self.periodic = periodic
        self.first = nn.Conv2d(channels, channels, 3, bias=False)
        self.first_norm = group_norm(channels)
        self.second = nn.Conv2d(channels, channels, 3, bias=False)
        self.second_norm = group_norm(channels)

    def forward(self, view: Float[Tensor, "B C X Y"]) -> Float[Tensor, "B C X Y"]:
        """Return a view of the same size."""
        change = F.relu(self.first_norm(self.first(pad_view(view, self.periodic))))
        return F.relu(view + self.second_norm(self.second(pad_view(change, self.periodic))))


class ChannelToHeight(nn.Module):
    """Turn columns of voxels into channels, apply residual blocks on a pyramid of halved views, and turn them back.

    FlashOcc (Yu et al., 2023) replaces the 3D convolutions of BEVDet's occupancy version in this way: only the linear
    maps at both ends depend on the height. Levels are merged as in `Conv`.

    Args:
        in_channels: of the lifted volume.
        channels: of the output.
        view_channels: of each level, finest first; multiples of 8.
        blocks: of each level.

    Raises:
        ValueError: if channels, blocks and periodic axes do not fit together.
    """

    def __init__(self, geometry: Grid, in_channels: int, channels: int, view_channels: list[int], blocks: list[int]):
        super().__init__()
        if len(view_channels) != len(blocks) or not blocks:
            raise ValueError(f"channels {view_channels} and blocks {blocks} must be one number each for every level")
        check_halvings(geometry, len(blocks))
        self.periodic = geometry.periodic
        self.channels = channels
        self.fold = nn.Linear(geometry.shape[2] * in_channels, view_channels[0])
        self.down = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairwise(view_channels))
        self.stages = nn.ModuleList(
            nn.Sequential(*(ViewBlock(width, self.periodic) for _ in range(count)))
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
