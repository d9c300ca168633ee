"""Feature pyramid network (Lin et al., 2017)."""

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F


def check_finest_first(levels: list[int]) -> None:
    """Raise ValueError unless the strides of maps increase, as those of the maps that `FPN` returns."""
    if sorted(set(levels)) != levels:
        raise ValueError(f"levels are {levels}; give each stride once, finest first: {sorted(set(levels))}")


class FPN(nn.Module):
    """Map features of several strides to the same channels and add coarser maps to finer ones.

    Args:
        in_channels: of the input maps, finest first.
        channels: of the output maps.
        keep: indices of the output maps.
    """

    def __init__(self, in_channels: list[int], channels: int, keep: list[int]):
        super().__init__()
        self.keep = keep
        self.lateral = nn.ModuleList(nn.Conv2d(count, channels, 1) for count in in_channels[min(keep) :])
        self.smooth = nn.ModuleDict({str(level): nn.Conv2d(channels, channels, 3, padding=1) for level in keep})

    def forward(self, maps: list[Float[Tensor, "B _ _ _"]]) -> list[Float[Tensor, "B C _ _"]]:
        """Return the kept maps, finest first, from all maps, finest first."""
        first = min(self.keep)
        sums = [lateral(level) for lateral, level in zip(self.lateral, maps[first:], strict=True)]
        for finer in range(len(sums) - 2, -1, -1):
            size = sums[finer].shape[-2:]
            sums[finer] = sums[finer] + F.interpolate(sums[finer + 1], size=size, mode="bilinear", align_corners=False)
        return [self.smooth[str(level)](sums[level - first]) for level in sorted(self.keep)]
