"""Deformable sampling on plain torch: weighted sums of bilinear samples for many queries at once.

`grid_sample` and a sum write every sample to memory, and the backward pass scatters every corner of every sample. Here
a query's samples are one bag of weighted rows (`embedding_bag`) and are never stored; backward, the samples are sorted
by pixel and the same operation is applied. Memory grows only with the samples of one head and level.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int32, Int64
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from omniocc.model.ops.multilinear import add_to_corners, bag_sum, corners, inner_products, sum_samples
from omniocc.model.ops.visible import Pairs


def ring_offsets(heads: int, levels: int, points: int, anchors: int) -> Float[Tensor, "H L 2 K"]:
    """Return the first offsets of samples, px: 0, 0.5, 1, ... from each anchor, in one direction for each head."""
    angle = torch.arange(heads) * (2 * math.pi / heads)
    direction = torch.stack([angle.cos(), angle.sin()], dim=-1)
    # the larger component is 1: samples of all heads lie on squares around the anchor, as in Deformable DETR
    direction = direction / direction.abs().amax(-1, keepdim=True)
    steps = torch.arange(points) % (points // anchors) / 2
    return (direction[..., None] * steps)[:, None].expand(-1, levels, -1, -1)


def transposed(linear: nn.Linear, queries: Float[Tensor, "Q C"]) -> Float[Tensor, "D Q"]:
    """Return `linear(queries)` transposed: queries run along the last axis, which makes softmax over samples fast."""
    return torch.addmm(linear.bias[:, None], linear.weight, queries.T)


class SampledAttention(nn.Module):
    """Hold the linear maps of deformable attention; before training, offsets and weights are equal for all queries.

    Args:
        channels: of values and output.
        query_channels: from which offsets and weights of the samples are computed.
        heads: a divisor of the channels.
        first_offsets: of all samples along all axes, before training, in the order of the linear map.
        axes: along which samples are moved.

    Raises:
        ValueError: if the heads do not divide the channels.
    """

    def __init__(self, channels: int, query_channels: int, heads: int, first_offsets: Float[Tensor, "..."], axes: int):
        super().__init__()
        if channels % heads:
            raise ValueError(f"{channels} channels cannot be split among {heads} heads; give a divisor")
        self.heads = heads
        self.value = nn.Linear(channels, channels)
        self.offsets = nn.Linear(query_channels, first_offsets.numel())
        self.attention = nn.Linear(query_channels, first_offsets.numel() // axes)
        self.output = nn.Linear(channels, channels)
        for layer in (self.offsets, self.attention):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        self.offsets.bias.data.copy_(first_offsets.flatten())

    def sum_among_cells(
        self,
        table: Float[Tensor, "R D"],
        places: Float[Tensor, "axes Q H K"],
        weights: Float[Tensor, "Q H K"],
        first: Int32[Tensor, "Q 1 _"],
        shape: Sequence[int],
        periodic: Sequence[bool],
    ) -> Float[Tensor, "Q C"]:
        """Return the weighted sum of samples at `places`, in cells, from a table by cell and head (see `Corners`).

        `first` is the table's cell with which the map of a query's samples begins.
        """
        found = corners(places, weights, shape, periodic)
        head = torch.arange(self.heads, dtype=torch.int32, device=table.device)
        row = (found.row + first) * self.heads + head[:, None]
        steps = tuple(step * self.heads for step in found.steps)
        return sum_samples(table, row.flatten(0, 1), found.weights.flatten(0, 1), steps).view(len(weights), -1)


def unravel(
    first: int, count: int, shape: Sequence[int], device: torch.device
) -> tuple[Int32[Tensor, " Q"], Float[Tensor, "axes Q"]]:
    """Return sample and place (in cells along each axis) of consecutive cells of a batch."""
    index = torch.arange(first, first + count, dtype=torch.int32, device=device)
    places = []
    for cells in reversed(shape):
        places.append(index % cells)
        index = torch.div(index, cells, rounding_mode="floor")
    return index, torch.stack(places[::-1]).to(torch.float32)


class Level(NamedTuple):
    """Reference points of the K samples of each pair on one level, before offsets.

    Positions are pixels of the level's maps padded by one pixel of zeros, (0, 0) being the centre of the padded corner.

    Attributes:
        x: reference column.
        y: reference row.
        row: table row of the padded corner of the pair's camera.
        width: of the padded maps.
        height: of the padded maps.
    """

    x: Float[Tensor, "P K"]
    y: Float[Tensor, "P K"]
    row: Int32[Tensor, "P K"]
    width: int
    height: int


class Samples(NamedTuple):
    """Bilinear samples of one head and level.

    Attributes:
        row: table row of the upper left corner.
        fx: fraction towards the right corners.
        fy: fraction towards the lower corners.
        inside_x: false where a position was clamped along x to the padding, which stops its gradient.
        inside_y: false where a position was clamped along y.
    """

    row: Int32[Tensor, "P K"]
    fx: Float[Tensor, "P K"]
    fy: Float[Tensor, "P K"]
    inside_x: Tensor
    inside_y: Tensor


def make_table(maps: Float[Tensor, "B N H C _ _"]) -> Float[Tensor, "H R BC"]:
    """Return one table per head of the maps of one level, with a row per pixel of the maps padded by zeros.

    Rows are ordered by camera, row, column; the channels of all samples are side by side.
    """
    return F.pad(maps, (1, 1, 1, 1)).permute(2, 1, 4, 5, 0, 3).flatten(4).flatten(1, 3)


def make_level(pairs: Pairs, height: int, width: int, points: int, dtype: torch.dtype) -> Level:
    """Return reference points of the pairs on a level whose maps are height x width px; anchors share the samples."""
    u, v = pairs.points.to(dtype).repeat_interleave(points // pairs.points.shape[1], dim=1).unbind(-1)
    x = ((u + 1) * width + 1) / 2
    y = ((v + 1) * height + 1) / 2
    row = pairs.camera.int() * ((height + 2) * (width + 2))
    return Level(x, y, row[:, None].expand(-1, points).contiguous(), width + 2, height + 2)


def _axis(anchor: Tensor, offset: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return the lower corner, the fraction, and whether the position is on the padded map."""
    raw = anchor + offset
    position = raw.clamp(0, size - 1)
    lower = position.floor().clamp_(max=size - 2)  # the upper corner is on the map too
    return lower, position - lower, raw == position


def _locate(level: Level, query: Int64[Tensor, " P"], offsets: Float[Tensor, "2 Q K"]) -> Samples:
    x, fx, inside_x = _axis(level.x, offsets[0].index_select(0, query), level.width)
    y, fy, inside_y = _axis(level.y, offsets[1].index_select(0, query), level.height)
    # exact in float32 up to 2**24 pixels; the index of a NaN is valid, its fraction remains NaN
    row = torch.add(x, y, alpha=level.width).int().clamp_(min=0).add_(level.row)
    return Samples(row, fx, fy, inside_x, inside_y)


def _corner_steps(width: int) -> tuple[int, int, int, int]:
    return 0, 1, width, width + 1


def _corner_weights(samples: Samples, weight: Float[Tensor, "P K"]) -> list[Float[Tensor, "P K"]]:
    lower = weight * samples.fy
    upper = weight - lower
    right, low_right = upper * samples.fx, lower * samples.fx
    return [upper - right, right, lower - low_right, low_right]


def _gather(
    table: Float[Tensor, "R C"], samples: Samples, weight: Float[Tensor, "P K"], first: Int64[Tensor, " Q"], width: int
) -> Float[Tensor, "Q C"]:
    """Return the weighted sum of the samples of each query."""
    bags = (first * weight.shape[1]).int()
    weighted = zip(_corner_steps(width), _corner_weights(samples, weight), strict=True)
    sums = [bag_sum((samples.row + step).flatten(), table, bags, weights.flatten()) for step, weights in weighted]
    return torch.stack(sums).sum(0)


def _scatter(
    grad: Float[Tensor, "Q C"],
    samples: Samples,
    weight: Float[Tensor, "P K"],
    query: Int64[Tensor, " P"],
    width: int,
    size: int,
) -> Float[Tensor, "R C"]:
    """Add the weighted gradient of each query to the rows of its samples' corners: the transpose of `_gather`."""
    rows = samples.row.flatten()
    # 16-bit numbers are sorted more than twice as fast as 32-bit ones, on the CPU
    order = (rows.short() if size < 2**15 else rows).argsort()
    sources = query.int().index_select(0, order // weight.shape[1])
    by_corner = (corner.flatten().index_select(0, order) for corner in _corner_weights(samples, weight))
    return add_to_corners(grad, rows, sources, zip(_corner_steps(width), by_corner, strict=True), size)


def _products(
    table: Float[Tensor, "R C"], samples: Samples, grad: Float[Tensor, "Q C"], first: Int64[Tensor, " Q"], width: int
) -> list[Float[Tensor, "P K"]]:
    """Return the inner product of each corner's row with the gradient of its sample's query."""
    shape = samples.row.shape
    ends = torch.cat([first * shape[1], first.new_tensor([samples.row.numel()])]).int()
    rows = [(samples.row + step).flatten() for step in _corner_steps(width)]
    return [inner_products(grad, table, ends, corner).reshape(shape) for corner in rows]


def _backward(
    table: Float[Tensor, "R C"],
    offsets: Float[Tensor, "2 Q K"],
    attention: Float[Tensor, "Q K"],
    grad: Float[Tensor, "Q C"],
    pairs: Pairs,
    level: Level,
) -> tuple[Float[Tensor, "R C"], Float[Tensor, "2 Q K"], Float[Tensor, "Q K"]]:
    """Return the gradients of one head and level, whose positions are computed again."""
    samples = _locate(level, pairs.query, offsets)
    weight = attention.index_select(0, pairs.query)
    corner, right, low, low_right = _products(table, samples, grad, pairs.first, level.width)
    upper_slope, lower_slope = right - corner, low_right - low
    upper = corner + samples.fx * upper_slope
    slope_y = low + samples.fx * lower_slope - upper
    slope_x = upper_slope + samples.fy * (lower_slope - upper_slope)
    value = upper + samples.fy * slope_y
    per_pair = torch.cat([slope_x * weight * samples.inside_x, slope_y * weight * samples.inside_y, value], dim=1)
    per_query = per_pair.new_zeros(len(grad), per_pair.shape[1]).index_add_(0, pairs.query, per_pair)
    grad_x, grad_y, grad_attention = per_query.chunk(3, dim=1)
    grad_table = _scatter(grad, samples, weight, pairs.query, level.width, len(table))
    return grad_table, torch.stack([grad_x, grad_y]), grad_attention


def _backward_of_table(
    offsets: Float[Tensor, "2 Q K"],
    attention: Float[Tensor, "Q K"],
    grad: Float[Tensor, "Q C"],
    pairs: Pairs,
    level: Level,
    size: int,
) -> Float[Tensor, "R C"]:
    """Return the gradient of the table of one head and level alone."""
    samples = _locate(level, pairs.query, offsets)
    return _scatter(grad, samples, attention.index_select(0, pairs.query), pairs.query, level.width, size)


class _DeformableSum(torch.autograd.Function):
    """Implement `deformable_sum` by heads and levels; only the inputs are kept for the backward pass."""

    @staticmethod
    def forward(
        ctx: Any, offsets: Tensor, attention: Tensor, pairs: Pairs, levels: list[Level], *tables: Tensor
    ) -> Tensor:
        ctx.save_for_backward(offsets, attention, *tables)
        ctx.pairs, ctx.levels = pairs, levels
        sums = []
        for head in range(len(offsets)):
            parts = []
            for index, (level, table) in enumerate(zip(levels, tables, strict=True)):
                samples = _locate(level, pairs.query, offsets[head, index])
                weight = attention[head, index].index_select(0, pairs.query)
                parts.append(_gather(table[head], samples, weight, pairs.first, level.width))
            sums.append(torch.stack(parts).sum(0) if len(parts) > 1 else parts[0])
        return torch.stack(sums)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Any:
        offsets, attention, *tables = ctx.saved_tensors
        fixed = not any(ctx.needs_input_grad[:2])  # the samples are not learned
        grad_offsets, grad_attention = (
            (None, None) if fixed else (torch.empty_like(offsets), torch.empty_like(attention))
        )
        grad_tables = [torch.empty_like(table) for table in tables]
        for head in range(len(offsets)):
            head_grad = grad[head].contiguous()
            for index, (level, table) in enumerate(zip(ctx.levels, tables, strict=True)):
                inputs = offsets[head, index], attention[head, index], head_grad, ctx.pairs, level
                if grad_offsets is None or grad_attention is None:
                    grad_tables[index][head] = _backward_of_table(*inputs, len(table[head]))
                else:
                    grads = _backward(table[head], *inputs)
                    grad_tables[index][head], grad_offsets[head, index], grad_attention[head, index] = grads
        return grad_offsets, grad_attention, None, None, *grad_tables


def deformable_sum(
    tables: list[Float[Tensor, "H _ C"]],
    offsets: Float[Tensor, "H L 2 Q K"],
    attention: Float[Tensor, "H L Q K"],
    pairs: Pairs,
    levels: list[Level],
) -> Float[Tensor, "H Q C"]:
    """Sample bilinearly at reference + offset, weight by attention, sum over levels, points and a query's cameras.

    Values outside the maps are zero, as in `grid_sample(padding_mode="zeros", align_corners=False)`. Differentiable
    once, in tables, offsets and attention.

    Args:
        tables: of each level, from `make_table`.
        offsets: (column, row) of each sample from its reference point, pixels of the level.
        attention: weight of each sample.
        pairs: visible (query, camera) pairs; at least one.
        levels: from `make_level`.
    """
    return _DeformableSum.apply(offsets, attention, pairs, levels, *tables)  # type: ignore[return-value]
