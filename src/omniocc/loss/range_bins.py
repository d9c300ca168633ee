"""Cross-entropy of distributions of range, for lifters that spread features along rays."""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Float32
from torch import Tensor, nn
from torch.nn import functional as F


class RangeBins(nn.Module):
    """Mean cross-entropy with the bin of the nearest surface in each cell of the image, in float32.

    The supervision of depth by BEVDepth (Li et al., 2023), with bins of range. Only cells whose nearest range is in a
    bin count: not those of the sky (inf), of the ego vehicle or outside the lens (nan), or of surfaces before the first
    or behind the last bin.

    Args:
        range_m: start of the first bin and end of the last one.
    """

    def __init__(self, range_m: Sequence[float | int]):
        super().__init__()
        self.begin_m, self.end_m = range_m

    def forward(
        self, logits: Float[Tensor, "B N D h w"], camera_range_m: Float[Tensor, "B N H W"]
    ) -> Float32[Tensor, ""]:
        """Return a scalar; 0 if no cell counts. Bins are of equal size; ranges are in metres."""
        bins, height, width = logits.shape[2:]
        known_m = camera_range_m.float().nan_to_num(torch.inf, posinf=torch.inf)
        nearest_m = -F.adaptive_max_pool2d(-known_m, (height, width))
        counted = (nearest_m >= self.begin_m) & (nearest_m < self.end_m)
        position = (nearest_m - self.begin_m) * (bins / (self.end_m - self.begin_m))
        target = torch.where(counted, position, 0.0).long().clamp(max=bins - 1)
        loss = F.cross_entropy(logits.flatten(0, 1).float(), target.flatten(0, 1), reduction="none")
        return torch.where(counted.flatten(0, 1), loss, 0.0).sum() / counted.sum().clamp(min=1)
