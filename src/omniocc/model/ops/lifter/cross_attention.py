"""Deformable cross-attention from voxels to the cameras that see them."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.model.ops.deformable_attention import (
    Level,
    SampledAttention,
    deformable_sum,
    make_table,
    ring_offsets,
    transposed,
)
from omniocc.model.ops.lifter.visible import Pairs
from omniocc.model.ops.padded import FeatureMaps


class CrossAttention(SampledAttention):
    """Apply multi-scale deformable attention (Zhu et al., 2021), averaged over the cameras that see a query (eq. 1).

    Offsets and attention depend only on the query and are equal for all cameras.

    Args:
        channels: of queries and features.
        heads: a divisor of the channels.
        points: samples per head and level.
        levels: number of feature maps.
        anchors: reference points of each query, a divisor of the points, which are split equally among them.
    """

    def __init__(self, channels: int, heads: int, points: int, levels: int, anchors: int):
        super().__init__(channels, channels, heads, ring_offsets(heads, levels, points, anchors), axes=2)
        self.points, self.levels = points, levels
        self.level_embedding = nn.Parameter(torch.zeros(levels, channels))

    def forward(
        self, queries: Float[Tensor, "G Q C"], features: FeatureMaps, pairs: Pairs, levels: list[Level]
    ) -> Float[Tensor, "B Q C"]:
        """Attend for B samples of equal rig and candidates; G is B, or 1 if the samples have the same queries."""
        samples = len(features[0]) // len(queries)
        maps = zip(*(level.split(samples) for level in features), strict=True)
        sums = [self._attend(query, list(part), pairs, levels) for query, part in zip(queries, maps, strict=True)]
        return self.output(torch.cat(sums))

    def _attend(
        self, queries: Float[Tensor, "Q C"], features: FeatureMaps, pairs: Pairs, levels: list[Level]
    ) -> Float[Tensor, "B Q C"]:
        """Attend with one set of queries to B samples, whose channels are side by side."""
        with torch.autocast(queries.device.type, enabled=False):
            dtype = torch.promote_types(queries.dtype, torch.float32)
            offsets, attention = self._sampling(queries.to(dtype))
            tables = [make_table(self._value(level.to(dtype), index)) for index, level in enumerate(features)]
            sums = deformable_sum(tables, offsets, attention, pairs, levels) / pairs.counts[:, None]
        return sums.unflatten(-1, (len(features[0]), -1)).permute(2, 1, 0, 3).flatten(2)

    def _sampling(self, queries: Float[Tensor, "Q C"]) -> tuple[Float[Tensor, "H L 2 Q K"], Float[Tensor, "H L Q K"]]:
        """Return offsets and attention."""
        shape = (self.heads, self.levels, self.points)
        offsets = transposed(self.offsets, queries).unflatten(0, (*shape[:2], 2, self.points))
        attention = transposed(self.attention, queries).unflatten(0, (self.heads, -1)).softmax(1)
        attention = attention.unflatten(1, shape[1:])
        return offsets.transpose(-1, -2).contiguous(), attention.transpose(-1, -2).contiguous()

    def _value(self, level: Float[Tensor, "B N C h w"], index: int) -> Float[Tensor, "B N H D h w"]:
        values = self.value(level.movedim(2, -1) + self.level_embedding[index])
        return values.movedim(-1, 2).unflatten(2, (self.heads, -1))
