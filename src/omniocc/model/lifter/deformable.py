"""Deformable sampling on plain torch: weighted sums of bilinear samples for many queries at once.

`grid_sample` and a sum write every sample to memory, and the backward pass scatters every corner of every sample. Here
a query's samples are one bag of weighted rows (`embedding_bag`), which never exist one by one; backward, the samples
are sorted by pixel and the same operation runs the other way round. Memory grows with the samples of one head only.
"""

import warnings
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int32, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from omniocc.model.lifter.visible import Pairs

Size = tuple[int, int]


class Anchors(NamedTuple):
    """Where the samples of all pairs start from, before offsets; S = levels * points.

    Positions are pixels of a level padded by one pixel of zeros, (0, 0) being the centre of the padding's corner.

    Attributes:
        query: query of each pair, ascending.
        first: index of each query's first pair.
        share: 1 / number of cameras that see the pair's query (paper eq. 1).
        x: reference column per sample.
        y: reference row per sample.
        row: table row of the padded map's corner per sample.
        width: padded width of each sample's level.
        height: padded height of each sample's level.
        levels: rows of the table and padded width, of each level.
    """

    query: Int64[Tensor, " P"]
    first: Int64[Tensor, " Q"]
    share: Float[Tensor, "P 1"]
    x: Float[Tensor, "P S"]
    y: Float[Tensor, "P S"]
    row: Int32[Tensor, "P S"]
    width: Int32[Tensor, " S"]
    height: Int32[Tensor, " S"]
    levels: list[tuple[int, int]]


class Samples(NamedTuple):
    """Bilinear samples of one head: the upper left corner's table row, fractions towards the others, and attention.

    `inside_x` and `inside_y` are false where a position was clamped to the padding, which stops its gradient.
    """

    row: Int32[Tensor, "P S"]
    fx: Float[Tensor, "P S"]
    fy: Float[Tensor, "P S"]
    weight: Float[Tensor, "P S"]
    inside_x: Tensor
    inside_y: Tensor


def make_table(maps: list[Float[Tensor, "B N H C _ _"]]) -> Float[Tensor, "H R BC"]:
    """Lays feature maps out as one table per head, a row per pixel of the maps padded by zeros.

    Args:
        maps: per level (samples, cameras, heads, channels, height, width).

    Returns:
        Rows ordered by (level, row, column) within (level, camera); the channels of all samples side by side.
    """
    tables = []
    for level in maps:
        padded = F.pad(level, (1, 1, 1, 1)).permute(2, 1, 4, 5, 0, 3)
        tables.append(padded.flatten(4).flatten(1, 3))
    return torch.cat(tables, dim=1)


def make_anchors(pairs: Pairs, cameras: int, sizes: list[Size], points: int, dtype: torch.dtype) -> Anchors:
    """Reference points of the pairs on every level.

    Args:
        pairs: visible (query, camera) pairs.
        cameras: number of cameras.
        sizes: (height, width) of the levels.
        points: samples per level.
        dtype: of positions.
    """
    device = pairs.query.device
    x, y, row, levels = [], [], [], []
    for rows, columns in sizes:
        u, v = pairs.points.to(dtype).unbind(-1)
        x.append(((u + 1) * columns + 1) / 2)
        y.append(((v + 1) * rows + 1) / 2)
        area = (rows + 2) * (columns + 2)
        row.append(sum(rows_before for rows_before, _ in levels) + pairs.camera * area)
        levels.append((cameras * area, columns + 2))
    return Anchors(
        query=pairs.query,
        first=pairs.counts.cumsum(0) - pairs.counts,
        share=(1 / pairs.counts.to(dtype))[pairs.query, None],
        x=torch.stack(x, 1).repeat_interleave(points, 1),
        y=torch.stack(y, 1).repeat_interleave(points, 1),
        row=torch.stack(row, 1).int().repeat_interleave(points, 1),
        width=torch.tensor([w + 2 for _, w in sizes], dtype=torch.int32, device=device).repeat_interleave(points),
        height=torch.tensor([h + 2 for h, _ in sizes], dtype=torch.int32, device=device).repeat_interleave(points),
        levels=levels,
    )


def _axis(anchor: Tensor, offset: Tensor, size: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Lower corner, fraction, and whether the position lies on the padded map."""
    raw = anchor + offset
    position = torch.minimum(raw.clamp(min=0), size - 1)
    lower = torch.minimum(position.floor(), size - 2)
    return lower, position - lower, raw == position


def _locate(anchors: Anchors, offsets: Float[Tensor, "2 Q S"], attention: Float[Tensor, "Q S"]) -> Samples:
    x, fx, inside_x = _axis(anchors.x, offsets[0].index_select(0, anchors.query), anchors.width)
    y, fy, inside_y = _axis(anchors.y, offsets[1].index_select(0, anchors.query), anchors.height)
    # exact in float32: a map has far fewer than 2**24 pixels
    row = (y * anchors.width + x).int() + anchors.row
    return Samples(row, fx, fy, attention.index_select(0, anchors.query) * anchors.share, inside_x, inside_y)


def _corner_rows(samples: Samples, anchors: Anchors) -> Int32[Tensor, "P S 4"]:
    zero = torch.zeros_like(anchors.width)
    steps = torch.stack([zero, zero + 1, anchors.width, anchors.width + 1], dim=-1)
    return samples.row[..., None] + steps


def _corner_weights(samples: Samples) -> Float[Tensor, "P S 4"]:
    lower = samples.weight * samples.fy
    upper = samples.weight - lower
    right, low_right = upper * samples.fx, lower * samples.fx
    return torch.stack([upper - right, right, lower - low_right, low_right], dim=-1)


def _bags(first: Tensor, entries_per_pair: int) -> Int32[Tensor, " Q"]:
    return (first * entries_per_pair).int()


def _corner_products(
    table: Float[Tensor, "R C"], grad: Float[Tensor, "Q C"], rows: Int32[Tensor, "P S 4"], first: Int64[Tensor, " Q"]
) -> Float[Tensor, "P S 4"]:
    """Inner product of each corner's row with the gradient of its query."""
    ends = torch.cat([_bags(first, rows[0].numel()), first.new_tensor([rows.numel()]).int()])
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse")  # CSR is marked beta; its checks cost more than the product
        pattern = torch.sparse_csr_tensor(
            ends, rows.flatten(), torch.zeros_like(rows, dtype=table.dtype).flatten(), (len(grad), len(table))
        )
        return torch.sparse.sampled_addmm(pattern, grad, table.T, beta=0.0).values().reshape(rows.shape)


def _scatter(samples: Samples, anchors: Anchors, grad: Float[Tensor, "Q C"], rows: int) -> Float[Tensor, "R C"]:
    """Adds the weighted gradient of each query to the rows of its samples' corners."""
    flat = samples.row.flatten()
    order = (flat.short() if rows < 2**15 else flat).argsort()
    query = anchors.query.int()[order // samples.row.shape[1]]
    weights = _corner_weights(samples).flatten(0, 1)[order].T.contiguous()
    counts = torch.bincount(flat, minlength=rows)
    first = _bags(counts.cumsum(0) - counts, 1)
    corners = [F.embedding_bag(query, grad, first, mode="sum", per_sample_weights=weight) for weight in weights]
    levels = [torch.split(corner, [size for size, _ in anchors.levels]) for corner in corners]
    for level, (_, width) in enumerate(anchors.levels):
        total, *others = (corner[level] for corner in levels)
        for other, step in zip(others, (1, width, width + 1), strict=True):
            total[step:] += other[:-step]
    return corners[0]


def _head_backward(
    table: Float[Tensor, "R C"],
    offsets: Float[Tensor, "2 Q S"],
    attention: Float[Tensor, "Q S"],
    grad: Float[Tensor, "Q C"],
    anchors: Anchors,
) -> tuple[Float[Tensor, "R C"], Float[Tensor, "2 Q S"], Float[Tensor, "Q S"]]:
    samples = _locate(anchors, offsets, attention)
    products = _corner_products(table, grad, _corner_rows(samples, anchors), anchors.first)
    corner, right, low, low_right = products.unbind(-1)
    upper_slope, lower_slope = right - corner, low_right - low
    upper = corner + samples.fx * upper_slope
    slope_y = low + samples.fx * lower_slope - upper
    slope_x = upper_slope + samples.fy * (lower_slope - upper_slope)
    per_pair = torch.stack(
        [
            slope_x * samples.weight * samples.inside_x,
            slope_y * samples.weight * samples.inside_y,
            (upper + samples.fy * slope_y) * anchors.share,
        ],
        dim=1,
    )
    per_query = per_pair.new_zeros(len(grad), *per_pair.shape[1:]).index_add_(0, anchors.query, per_pair)
    return _scatter(samples, anchors, grad, len(table)), per_query[:, :2].transpose(0, 1), per_query[:, 2]


class _DeformableSum(torch.autograd.Function):
    """See `deformable_sum`; only the inputs are kept, positions are computed again in the backward pass."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, offsets: Tensor, attention: Tensor, anchors: Anchors) -> Tensor:
        ctx.save_for_backward(table, offsets, attention)
        ctx.anchors = anchors
        sums = []
        for head in range(len(table)):
            samples = _locate(anchors, offsets[head], attention[head])
            rows = _corner_rows(samples, anchors)
            weights = _corner_weights(samples).flatten()
            bags = _bags(anchors.first, rows[0].numel())
            sums.append(F.embedding_bag(rows.flatten(), table[head], bags, mode="sum", per_sample_weights=weights))
        return torch.stack(sums)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Any:
        table, offsets, attention = ctx.saved_tensors
        grads = [
            _head_backward(table[head], offsets[head], attention[head], grad[head].contiguous(), ctx.anchors)
            for head in range(len(table))
        ]
        return *(torch.stack(parts) for parts in zip(*grads, strict=True)), None


def deformable_sum(
    table: Float[Tensor, "H R C"],
    offsets: Float[Tensor, "H 2 Q S"],
    attention: Float[Tensor, "H Q S"],
    anchors: Anchors,
) -> Float[Tensor, "H Q C"]:
    """Samples bilinearly at anchor + offset, weights by attention, sums, averages over a query's cameras (paper eq. 1).

    Outside the maps there are zeros, as with `grid_sample(padding_mode="zeros", align_corners=False)`. Queries that no
    camera sees get zeros. Differentiable once, in table, offsets and attention.

    Args:
        table: of `make_table`.
        offsets: (column, row) of each sample from its anchor, pixels of the sample's level.
        attention: weight of each sample.
        anchors: of `make_anchors`.
    """
    if not len(anchors.query):
        return table.new_zeros(len(table), len(anchors.first), table.shape[2])
    return _DeformableSum.apply(table, offsets, attention, anchors)  # type: ignore[return-value]
