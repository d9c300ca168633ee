"""The coloring module: candidate voxels attend to image features (paper, section IV-C, eq. 1)."""

from collections.abc import Sequence
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.bounds import Count, Size
from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.ops.blocks import block_any, block_means
from omniocc.model.ops.deformable_attention import (
    Level,
    SampledAttention,
    deformable_sum,
    level_of_every_cell,
    make_level,
    make_table,
    ring_offsets,
    transposed,
)
from omniocc.model.ops.evidence import INPUTS, network_inputs
from omniocc.model.ops.feedforward import AttentionLayer
from omniocc.model.ops.lenses import Lens, taken_for
from omniocc.model.ops.padded import FeatureMaps, crop, in_batch_order
from omniocc.model.ops.padding import Axes
from omniocc.model.ops.static import is_static
from omniocc.model.ops.visible import CENTRE, Pairs, every_cell, group_samples, marked_cells
from omniocc.model.protocols import Sketched

OCTAVES = 4
"""Multiples of angles, and powers of two of lengths, in the features of a position."""


class Coloring(nn.Module):
    """Lift image features into the candidate voxels by deformable cross-attention through each sample's own rig.

    A query starts as an embedding of its voxel's position, and of the sketch's evidence if it is used. Work and memory
    grow with the number of visible (candidate, camera) pairs. Candidates that no camera sees keep their embedding; all
    other voxels get one learned vector, the mask token of VoxFormer (Li et al., 2023).

    Args:
        channels: of image features, queries and volume.
        levels: strides of the feature maps, px.
        layers: of cross-attention, each followed by a feed-forward part.
        heads: of attention, a divisor of the channels.
        points: samples per head and level.
        feedforward_channels: hidden channels of the feed-forward part.
        anchors: reference points of a voxel, as offsets from its centre along the grid's axes in cells, -0.5 to 0.5.
            The points are split among them at no extra cost. A camera is attended to if it sees one of them.
        evidence: whether queries also start from the sketch's evidence.
        lens: what the cameras are taken for, see `omniocc.model.ops.lenses`.

    Raises:
        ValueError: if the heads do not divide the channels, the anchors not the points, or an anchor leaves its cell.
    """

    positions: Tensor

    def __init__(
        self,
        geometry: Grid,
        channels: Size,
        levels: list[int],
        layers: Count,
        heads: Count,
        points: Count,
        feedforward_channels: Size,
        anchors: Sequence[Sequence[float | int]] = CENTRE,
        evidence: bool = False,
        lens: Lens = "own",
    ):
        super().__init__()
        if not anchors or points % len(anchors):
            raise ValueError(f"{points} points cannot be split among {len(anchors)} anchors; give a multiple")
        if any(len(anchor) != 3 or max(map(abs, anchor)) > 0.5 for anchor in anchors):
            raise ValueError(f"anchors are {list(anchors)}; each must be three numbers from -0.5 to 0.5")
        self.geometry = geometry
        self.lens: Lens = lens
        self.channels = channels
        self.strides = list(levels)
        self.points, self.heads = points, heads
        self.anchors = tuple((float(first), float(second), float(third)) for first, second, third in anchors)
        self.register_buffer("positions", position_features(geometry), persistent=False)
        first, second = nn.Linear(self.positions.shape[1], channels), nn.Linear(channels, channels)
        self.embedding = nn.Sequential(first, nn.ReLU(), second, nn.LayerNorm(channels))
        self.evidence = nn.Linear(INPUTS, channels) if evidence else None
        self.layers = nn.ModuleList(
            AttentionLayer(
                CrossAttention(channels, heads, points, len(levels), len(anchors)), channels, feedforward_channels
            )
            for _ in range(layers)
        )
        self.empty = nn.Parameter(torch.zeros(channels))

    def forward(self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]) -> Float[Tensor, "B C X Y Z"]:
        """Colour the candidates; samples of equal rig, candidates and evidence are computed together.

        Raises:
            ValueError: if a rig has more cameras or larger images than there are maps for, or there is no evidence.
        """
        evidence = None if self.evidence is None else sketched.evidence()
        return self.color(features, sketched.candidates, taken_for(self.lens, rigs), evidence)

    def color(
        self,
        features: FeatureMaps,
        candidates: Bool[Tensor, "B X Y Z"],
        rigs: tuple[Rig, ...],
        evidence: Float[Tensor, "B 4 X Y Z"] | None = None,
        start: Float[Tensor, "B C X Y Z"] | None = None,
    ) -> Float[Tensor, "B C X Y Z"]:
        """Do what `forward` does, from queries that may know more than their position.

        The features `start` of all voxels are added to the embeddings of the queries, and to the vector of the voxels
        that are no candidates.
        """
        marked = candidates.flatten(1)
        if evidence is not None:
            evidence = network_inputs(evidence).flatten(2).transpose(1, 2)
        rows = None if start is None else start.flatten(2).transpose(1, 2)
        groups = group_samples(rigs, marked, evidence)
        parts = []
        for group in groups:
            maps = features if len(groups) == 1 else [level[group] for level in features]
            first = group[0]
            inputs = None if evidence is None else evidence[first], None if rows is None else rows[group]
            parts.append(self._color(maps, marked[first], *inputs, rigs[first]))
        # channels last in memory, which is fast in 3D convolutions
        return in_batch_order(parts, groups).unflatten(1, self.geometry.shape).movedim(-1, 1)

    def color_blocks(
        self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...], block: Axes
    ) -> Float[Tensor, "B C x y z"]:
        """Colour blocks of a finer grid's voxels, from their mean evidence; those with a candidate are candidates."""
        evidence = None if self.evidence is None else block_means(sketched.evidence(), block)
        return self.color(features, block_any(sketched.candidates, block), rigs, evidence)

    def _color(
        self,
        features: FeatureMaps,
        marked: Bool[Tensor, " cells"],
        evidence: Float[Tensor, "cells E"] | None,
        start: Float[Tensor, "B cells C"] | None,
        rig: Rig,
    ) -> Float[Tensor, "B cells C"]:
        features = [crop(level, rig, stride) for level, stride in zip(features, self.strides, strict=True)]
        batch = len(features[0])
        whole = is_static()  # the result is the same, since queries do not attend to each other
        key = rig, self.geometry, marked.device, self.anchors
        cells, seen, pairs = every_cell(*key) if whole else marked_cells(marked, *key)
        embedding = self.embedding(self.positions if whole else self.positions[cells])
        if self.evidence is not None and evidence is not None:
            embedding = embedding + self.evidence(evidence if whole else evidence[cells])
        others = self.empty[None, None] if start is None else self.empty + start
        embedding = embedding[None] if start is None else embedding + (start if whole else start[:, cells])
        queries = embedding[:, seen]
        dtype = torch.promote_types(embedding.dtype, torch.float32)
        sizes = [level.shape[-2:] for level in features]
        make = partial(level_of_every_cell, *key) if whole else partial(make_level, pairs)
        levels = [make(*size, self.points, self.heads, dtype) for size in sizes]
        for layer in self.layers:
            queries = layer(queries, features, pairs, levels)
        embedding, others = embedding.to(queries.dtype), others.to(queries.dtype).expand(-1, len(marked), -1)
        if whole:
            volume = embedding.expand(batch, -1, -1).index_copy(1, seen, queries)
            return torch.where(marked[:, None], volume, others)
        volume = others.index_copy(1, cells, embedding)
        return volume.expand(batch, -1, -1).index_copy(1, cells[seen], queries)


def position_features(geometry: Grid) -> Float[Tensor, "cells D"]:
    """Return features of the metric coordinates of every cell's centre, row-major, for grids of any kind.

    They are x, y, z and radius scaled to [-1, 1] (or [0, 1]), and sine and cosine of multiples of the azimuth, radius
    and height; all are continuous where the azimuth is not.
    """
    centers_m = geometry.centers(torch.float64).reshape(-1, 3)
    x, y, z = centers_m.unbind(-1)
    radius = torch.hypot(x, y)
    azimuth = torch.atan2(y, x)
    radius_unit = radius / radius.max()
    low, high = z.min(), z.max()
    height_unit = (2 * z - low - high) / (high - low).clamp(min=1e-9)
    waves = [azimuth * k for k in range(1, OCTAVES + 1)]
    waves += [torch.pi * 2**k * unit for k in range(OCTAVES) for unit in (radius_unit, height_unit)]
    columns = [x / radius.max(), y / radius.max(), height_unit, radius_unit]
    columns += [wave for angle in waves for wave in (angle.sin(), angle.cos())]
    return torch.stack(columns, dim=-1).float()


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
            sums = deformable_sum(tables, offsets, attention, levels) / pairs.counts[:, None]
        return sums.unflatten(-1, (len(features[0]), -1)).permute(2, 1, 0, 3).flatten(2)

    def _sampling(self, queries: Float[Tensor, "Q C"]) -> tuple[Float[Tensor, "H L 2 Q K"], Float[Tensor, "H L Q K"]]:
        shape = (self.heads, self.levels, self.points)
        offsets = transposed(self.offsets, queries).unflatten(0, (*shape[:2], 2, self.points))
        attention = transposed(self.attention, queries).unflatten(0, (self.heads, -1)).softmax(1)
        attention = attention.unflatten(1, shape[1:])
        return offsets.transpose(-1, -2).contiguous(), attention.transpose(-1, -2).contiguous()

    def _value(self, level: Float[Tensor, "B N C h w"], index: int) -> Float[Tensor, "B N H D h w"]:
        values = self.value(level.movedim(2, -1) + self.level_embedding[index])
        return values.movedim(-1, 2).unflatten(2, (self.heads, -1))
