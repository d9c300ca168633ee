"""Deformable sampling on plain torch: weighted sums of bilinear samples for many queries at once.

`grid_sample` and a sum write every sample to memory, and the backward pass scatters every corner of every sample. Here
a query's samples are one bag of weighted rows (`embedding_bag`) and are never stored; backward, the samples are sorted
by pixel and the same operation is applied. All heads of a level are computed together, or as many at a time as have
`TOGETHER` samples, on which memory depends.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int32, Int64
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.ops.multilinear import bag_sum, corners, inner_products, sum_samples
from omniocc.model.ops.padded import joined
from omniocc.model.ops.rig_cache import once_per_rig
from omniocc.model.ops.visible import CENTRE, Anchors, Pairs, every_cell

TOGETHER = 2**19
"""Samples of one level that are computed together on a CPU, at least those of one head."""
TOGETHER_ON_GPU = 2**23


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
    """Reference points of the K samples of each pair on one level, before offsets, and the bags of the samples.

    Positions are pixels of the level's maps padded by one pixel of zeros, (0, 0) being the centre of the padded corner.

    Attributes:
        places: reference column and row.
        last: of the column and of the row, the last one of the padded maps.
        row: table row of the padded corner of the pair's camera.
        width: of the padded maps.
        steps: table rows from the upper left corner of a sample to its four corners.
        heads: that are computed together.
        query: of each head and pair in turn, the row of its query in tables of all heads one below the other.
        first: of each corner, head and query in turn, the first of its samples.
    """

    places: Float[Tensor, "2 P K"]
    last: Float[Tensor, "2 1 1"]
    row: Int32[Tensor, "P 1"]
    width: int
    steps: Int32[Tensor, "4 1 1 1"]
    heads: int
    query: Int64[Tensor, " HP"]
    first: Int32[Tensor, " bags"]


class Samples(NamedTuple):
    """Bilinear samples of some heads on one level.

    Attributes:
        row: table row of the upper left corner.
        fraction: towards the right corners, and towards the lower ones.
        raw: column and row before they were clamped to the padding.
        position: column and row.
    """

    row: Int32[Tensor, "H P K"]
    fraction: Float[Tensor, "H 2 P K"]
    raw: Float[Tensor, "H 2 P K"]
    position: Float[Tensor, "H 2 P K"]


def make_table(maps: Float[Tensor, "B N H C _ _"]) -> Float[Tensor, "H R BC"]:
    """Return one table per head of the maps of one level, with a row per pixel of the maps padded by zeros.

    Rows are ordered by camera, row, column; the channels of all samples are side by side.
    """
    return F.pad(maps, (1, 1, 1, 1)).permute(2, 1, 4, 5, 0, 3).flatten(4).flatten(1, 3)


def make_level(pairs: Pairs, height: int, width: int, points: int, heads: int, dtype: torch.dtype) -> Level:
    """Return reference points of the pairs on a level whose maps are height x width px; anchors share the samples."""
    anchors = pairs.points.to(dtype).movedim(-1, 0).repeat_interleave(points // pairs.points.shape[1], dim=-1)
    size = anchors.new_tensor([width, height]).view(2, 1, 1)
    row = pairs.camera.int()[:, None] * ((height + 2) * (width + 2))
    entries = len(row) * points
    together = TOGETHER_ON_GPU if row.device.type == "cuda" else TOGETHER
    heads = min(heads, max(1, together // max(entries, 1)))
    number = torch.arange(4 * heads, device=row.device)[:, None]
    query = (number[: 2 * heads] * len(pairs.first) + pairs.query).flatten()  # for two numbers each
    first = (number * entries + pairs.first * points).flatten().int()
    steps = row.new_tensor([0, 1, width + 2, width + 3]).view(4, 1, 1, 1)
    return Level(((anchors + 1) * size + 1) / 2, size + 1, row, width + 2, steps, heads, query, first)


@once_per_rig
def level_of_every_cell(
    rig: Rig,
    geometry: Grid,
    device: torch.device,
    anchors: Anchors,
    height: int,
    width: int,
    points: int,
    heads: int,
    dtype: torch.dtype,
) -> Level:
    """Return the result of `make_level` for the pairs of `every_cell`; never write to the result, which is cached."""
    return make_level(every_cell(rig, geometry, device, anchors)[2], height, width, points, heads, dtype)


def _of_pairs(level: Level, values: Float[Tensor, "*H Q K"]) -> Float[Tensor, "*H P K"]:
    """Return each pair's values of its query."""
    rows = values.flatten(0, -2)
    count = values.shape[:-2].numel() * len(level.row)
    return rows.index_select(0, level.query[:count]).view(*values.shape[:-2], -1, values.shape[-1])


def _locate(level: Level, offsets: Float[Tensor, "H 2 Q K"]) -> Samples:
    raw = level.places + _of_pairs(level, offsets)
    position = raw.clamp(min=0).minimum(level.last)
    lower = position.floor().minimum(level.last - 1)  # the upper corner is on the map too
    # exact in float32 up to 2**24 pixels; the index of a NaN is valid, its fraction remains NaN
    row = torch.add(lower[:, 0], lower[:, 1], alpha=level.width).int().clamp_(min=0).add_(level.row)
    return Samples(row, position - lower, raw, position)


def _corner_weights(samples: Samples, weight: Float[Tensor, "H P K"]) -> Float[Tensor, "4 H P K"]:
    fx, fy = samples.fraction.unbind(1)
    lower = weight * fy
    rows = torch.stack([weight - lower, lower])
    right = rows * fx
    return torch.stack([rows - right, right], 1).flatten(0, 1)


def _corner_rows(samples: Samples, level: Level, size: int) -> Int32[Tensor, "4 H P K"]:
    """Return rows of the tables of all heads, one below the other."""
    heads = torch.arange(0, len(samples.row) * size, size, dtype=torch.int32, device=level.steps.device)
    return samples.row + (level.steps + heads[:, None, None])


def _gather(
    table: Float[Tensor, "H R C"], samples: Samples, weight: Float[Tensor, "H P K"], level: Level
) -> Float[Tensor, "H Q C"]:
    """Return the weighted sum of the samples of each query."""
    rows, weights = _corner_rows(samples, level, table.shape[1]), _corner_weights(samples, weight)
    first = level.first.view(4 * level.heads, -1)[: 4 * len(table)].flatten()
    sums = bag_sum(rows.flatten(), table.flatten(0, 1), first, weights.flatten())
    return sums.view(4, len(table), -1, table.shape[2]).sum(0)


@once_per_rig
def centres_of_every_cell(
    rig: Rig, geometry: Grid, device: torch.device, height: int, width: int, dtype: torch.dtype
) -> tuple[Int32[Tensor, " E"], Float[Tensor, " E"], Int32[Tensor, " bags"]]:
    """Return rows, weights and bags of the samples at the middle of every cell, in maps that are height x width px.

    A seen cell has four bags, one for each corner. The result is cached: never write to it.
    """
    level = level_of_every_cell(rig, geometry, device, CENTRE, height, width, 1, 1, dtype)
    samples = _locate(level, level.places.new_zeros(1, 2, len(level.first) // 4, 1))
    weights = _corner_weights(samples, torch.ones_like(samples.raw[:, 0]))
    return (samples.row + level.steps).flatten(), weights.flatten(), level.first


def _scatter(
    grad: Float[Tensor, "H Q C"],
    samples: Samples,
    weight: Float[Tensor, "H P K"],
    level: Level,
    size: int,
) -> Float[Tensor, "H R C"]:
    """Add the weighted gradient of each query to the rows of its samples' corners: the transpose of `_gather`."""
    heads = len(grad)
    rows = samples.row.flatten(1)
    # 16-bit numbers are sorted more than twice as fast as 32-bit ones, and each head alone many times, on the CPU
    orders = [own.argsort() for own in (rows.short() if size < 2**15 else rows)]
    head = torch.arange(heads, dtype=torch.int32, device=rows.device)[:, None]
    order = (torch.stack(orders) + head * rows.shape[1]).flatten()
    sources = level.query.int().index_select(0, order // weight.shape[2])
    counts = torch.bincount((rows + head * size).flatten(), minlength=heads * size)
    corner = torch.arange(4, device=rows.device)[:, None] * len(order)
    bags = (counts.cumsum(0) - counts + corner).int().flatten()
    weights = _corner_weights(samples, weight).flatten(1).index_select(1, order)
    by_lowest = bag_sum(sources.repeat(4), grad.flatten(0, 1), bags, weights.flatten()).view(4, heads, size, -1)
    total = by_lowest[0].clone()
    for step, sums in zip((1, level.width, level.width + 1), by_lowest[1:], strict=True):
        total[:, step:] += sums[:, : size - step]
    return total


def _products(
    table: Float[Tensor, "H R C"], samples: Samples, grad: Float[Tensor, "H Q C"], level: Level
) -> Float[Tensor, "4 H P K"]:
    """Return the inner product of each corner's row with the gradient of its sample's query."""
    rows = _corner_rows(samples, level, table.shape[1])
    first = level.first.view(4 * level.heads, -1)[: 4 * len(table)].flatten()
    ends = torch.cat([first, first.new_tensor([rows.numel()])])
    products = inner_products(grad.flatten(0, 1).repeat(4, 1), table.flatten(0, 1), ends, rows.flatten())
    return products.view(rows.shape)


def _backward(
    table: Float[Tensor, "H R C"],
    offsets: Float[Tensor, "H 2 Q K"],
    attention: Float[Tensor, "H Q K"],
    grad: Float[Tensor, "H Q C"],
    level: Level,
    fixed: bool,
) -> tuple[Float[Tensor, "H R C"], Float[Tensor, "H 2 Q K"] | None, Float[Tensor, "H Q K"] | None]:
    """Return the gradients of some heads on one level, whose positions are computed again.

    If the samples are `fixed`, only the table has a gradient.
    """
    samples, weight = _locate(level, offsets), _of_pairs(level, attention)
    grad_table = _scatter(grad, samples, weight, level, table.shape[1])
    if fixed:
        return grad_table, None, None
    corner, right, low, low_right = _products(table, samples, grad, level)
    fx, fy = samples.fraction.unbind(1)
    upper_slope, lower_slope = right - corner, low_right - low
    upper = corner + fx * upper_slope
    slope_y = low + fx * lower_slope - upper
    slope_x = upper_slope + fy * (lower_slope - upper_slope)
    value = upper + fy * slope_y
    inside = samples.raw == samples.position  # what was clamped has no gradient
    slopes = torch.stack([slope_x, slope_y], 1) * weight[:, None] * inside
    per_pair = torch.cat([*slopes.unbind(1), value], -1).flatten(0, 1)
    per_query = per_pair.new_zeros(grad.shape[:2].numel(), per_pair.shape[1])
    per_query.index_add_(0, level.query[: len(per_pair)], per_pair)
    grad_x, grad_y, grad_attention = per_query.view(*grad.shape[:2], per_pair.shape[1]).chunk(3, dim=-1)
    return grad_table, torch.stack([grad_x, grad_y], 1), grad_attention


class _DeformableSum(torch.autograd.Function):
    """Implement `deformable_sum` by levels and some heads; only the inputs are kept for the backward pass."""

    @staticmethod
    def forward(ctx: Any, offsets: Tensor, attention: Tensor, levels: list[Level], *tables: Tensor) -> Tensor:
        ctx.save_for_backward(offsets, attention, *tables)
        ctx.levels = levels
        parts = []
        for index, (level, table) in enumerate(zip(levels, tables, strict=True)):
            inputs = table, offsets[:, index], attention[:, index]
            heads = zip(*(part.split(level.heads) for part in inputs), strict=True)
            sums = [
                _gather(rows, _locate(level, moves), _of_pairs(level, weight), level) for rows, moves, weight in heads
            ]
            parts.append(joined(sums))
        return torch.stack(parts).sum(0) if len(parts) > 1 else parts[0]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Any:
        offsets, attention, *tables = ctx.saved_tensors
        fixed = not any(ctx.needs_input_grad[:2])  # the samples are not learned
        grads = []
        for index, (level, table) in enumerate(zip(ctx.levels, tables, strict=True)):
            inputs = table, offsets[:, index], attention[:, index], grad.contiguous()
            heads = zip(*(part.split(level.heads) for part in inputs), strict=True)
            found = [_backward(*part, level=level, fixed=fixed) for part in heads]
            grads.append([None if part[0] is None else joined(part) for part in zip(*found, strict=True)])
        grad_tables, *rest = zip(*grads, strict=True)
        grad_offsets, grad_attention = (None if part[0] is None else torch.stack(part, 1) for part in rest)
        return grad_offsets, grad_attention, None, *grad_tables


def deformable_sum(
    tables: list[Float[Tensor, "H _ C"]],
    offsets: Float[Tensor, "H L 2 Q K"],
    attention: Float[Tensor, "H L Q K"],
    levels: list[Level],
) -> Float[Tensor, "H Q C"]:
    """Sample bilinearly at reference + offset, weight by attention, sum over levels, points and a query's cameras.

    Values outside the maps are zero, as in `grid_sample(padding_mode="zeros", align_corners=False)`. Differentiable
    once, in tables, offsets and attention.

    Args:
        tables: of each level, from `make_table`.
        offsets: (column, row) of each sample from its reference point, pixels of the level.
        attention: weight of each sample.
        levels: from `make_level`, of the same visible (query, camera) pairs, at least one.
    """
    return _DeformableSum.apply(offsets, attention, levels, *tables)  # type: ignore[return-value]
