"""Deformable cross-attention from voxels to the cameras that see them."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.model.lifter.deformable import deformable_sum, make_anchors, make_table
from omniocc.model.lifter.visible import Pairs


def ring_offsets(heads: int, levels: int, points: int) -> Float[Tensor, "H 2 levels*points"]:
    """Where samples begin, in pixels: each head looks in a direction of its own, its points 1, 2, ... pixels away."""
    angle = torch.arange(heads) * (2 * math.pi / heads)
    direction = torch.stack([angle.cos(), angle.sin()], dim=-1)
    direction = direction / direction.abs().amax(-1, keepdim=True)
    return direction[..., None] * torch.arange(1, points + 1).repeat(levels)


class CrossAttention(nn.Module):
    """Multi-scale deformable attention (Zhu et al., 2021), averaged over the cameras that see a query (paper eq. 1).

    Offsets and attention come from the query alone; all cameras share them.

    Args:
        channels: of queries and features.
        heads: a divisor of the channels.
        points: samples per head and level.
        levels: number of feature maps.
    """

    def __init__(self, channels: int, heads: int, points: int, levels: int):
        super().__init__()
        self.heads, self.points, self.levels = heads, points, levels
        samples = levels * points
        self.value = nn.Linear(channels, channels)
        self.level_embedding = nn.Parameter(torch.zeros(levels, channels))
        self.offsets = nn.Linear(channels, heads * 2 * samples)
        self.attention = nn.Linear(channels, heads * samples)
        self.output = nn.Linear(channels, channels)
        for layer in (self.offsets, self.attention):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        self.offsets.bias.data.copy_(ring_offsets(heads, levels, points).flatten())

    def forward(
        self, queries: Float[Tensor, "G Q C"], features: list[Float[Tensor, "B N C _ _"]], pairs: Pairs
    ) -> Float[Tensor, "B Q C"]:
        """Attends for B samples of equal rig and candidates; G is B, or 1 if the samples still share their queries."""
        share = len(features[0]) // len(queries)
        maps = zip(*(level.split(share) for level in features), strict=True)
        sums = [self._attend(query, list(levels), pairs) for query, levels in zip(queries, maps, strict=True)]
        return self.output(torch.cat(sums))

    def _attend(
        self, queries: Float[Tensor, "Q C"], features: list[Float[Tensor, "B N C _ _"]], pairs: Pairs
    ) -> Float[Tensor, "B Q C"]:
        """One set of queries on B samples, whose channels travel side by side: positions are computed once."""
        with torch.autocast(queries.device.type, enabled=False):
            dtype = torch.promote_types(queries.dtype, torch.float32)
            queries = queries.to(dtype)
            offsets = self.offsets(queries).unflatten(-1, (self.heads, 2, -1)).permute(1, 2, 0, 3)
            attention = self.attention(queries).unflatten(-1, (self.heads, -1)).softmax(-1).permute(1, 0, 2)
            table = make_table([self._value(level.to(dtype), index) for index, level in enumerate(features)])
            sizes = [(level.shape[-2], level.shape[-1]) for level in features]
            anchors = make_anchors(pairs, features[0].shape[1], sizes, self.points, dtype)
            sums = deformable_sum(table, offsets.contiguous(), attention.contiguous(), anchors)
        return sums.unflatten(-1, (len(features[0]), -1)).permute(2, 1, 0, 3).flatten(2)

    def _value(self, level: Float[Tensor, "B N C h w"], index: int) -> Float[Tensor, "B N H D h w"]:
        values = self.value(level.movedim(2, -1) + self.level_embedding[index])
        return values.movedim(-1, 2).unflatten(2, (self.heads, -1))
