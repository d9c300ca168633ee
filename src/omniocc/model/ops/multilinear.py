"""Weighted sums of bilinear (2D) or trilinear (3D) samples on plain torch.

The forward pass adds up all corners of all samples of a sum as one bag of weighted table rows (`embedding_bag`), so
that no sample is stored. The backward pass sorts the samples once by their lowest corner. The gradient of a table row
is then a sum of bags, which a CPU adds up several times faster than it scatters every corner.

Letters in shapes: N sums (bags) of K samples with E corners each; a table of R rows with C channels.
"""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int32
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

CHUNK_SUMS = 2**15
"""Sums whose inner products are computed together, few enough for their arrays to stay in the processor's cache."""


def bag_sum(
    rows: Int32[Tensor, "..."], table: Tensor, first: Int32[Tensor, " bags"] | None, weights: Float[Tensor, "..."]
) -> Tensor:
    """Return the weighted sum of the table rows of each bag.

    Args:
        rows: table row of each entry; without `first` each line (last axis) is one bag.
        table: the rows that are added up.
        first: index of each bag's first entry, where `rows` has one axis.
        weights: of each entry.
    """
    return F.embedding_bag(rows, table, first, mode="sum", per_sample_weights=weights)


def inner_products(
    left: Float[Tensor, "N C"], right: Float[Tensor, "R C"], ends: Int32[Tensor, " N+1"], rows: Int32[Tensor, " E"]
) -> Float[Tensor, " E"]:
    """Return, for each n, the inner products of row n of `left` with rows `rows[ends[n]:ends[n + 1]]` of `right`."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse")  # CSR is marked beta
        pattern = torch.sparse_csr_tensor(ends, rows, left.new_zeros(len(rows)), (len(left), len(right)))
        return torch.sparse.sampled_addmm(pattern, left, right.T, beta=0.0).values()


def add_to_corners(
    grad: Float[Tensor, "N C"],
    rows: Int32[Tensor, " S"],
    sources: Int32[Tensor, " S"],
    weighted: Iterable[tuple[int, Float[Tensor, " S"]]],
    size: int,
) -> Float[Tensor, "R C"]:
    """Return the gradient of a table: the weighted gradients of sums, added to the rows of their samples' corners.

    Args:
        grad: of each sum.
        rows: lowest corner of each sample, in any order.
        sources: index of each sample's sum; the samples are sorted by their lowest corner.
        weighted: for each corner, its distance in rows from the lowest one, and the weights in the order of `sources`.
        size: number of rows of the table, R.
    """
    counts = torch.bincount(rows, minlength=size)
    first = (counts.cumsum(0) - counts).int()
    total = torch.zeros(size, grad.shape[1], dtype=grad.dtype, device=grad.device)
    for step, weights in weighted:
        by_lowest = bag_sum(sources, grad, first, weights)
        total[step:] += by_lowest[: size - step]
    return total


class Corners(NamedTuple):
    """Where samples lie in a table, whose rows are the cells of a map, row-major, padded by one cell at every end.

    Attributes:
        row: table row of the lowest corner.
        weights: of all corners, times the weight of the sample.
        steps: distance in rows from the lowest corner to each corner.
    """

    row: Int32[Tensor, "*S"]
    weights: Float[Tensor, "*S corners"]
    steps: tuple[int, ...]


def corners(
    positions: Float[Tensor, "D *S"], weights: Float[Tensor, "*S"], shape: Sequence[int], periodic: Sequence[bool]
) -> Corners:
    """Return the corners of samples and their multilinear weights.

    Positions wrap around on periodic axes. On other axes they are clamped to the middle of the padding, where they have
    no gradient. A nan position gets a valid row and nan weights.

    Args:
        positions: along each axis in cells, 0 in the middle of the map's first cell.
        weights: of each sample.
        shape: cells of the map along each axis.
        periodic: which axes wrap around.
    """
    row = torch.zeros_like(weights, dtype=torch.int32)
    spread, steps = weights.unsqueeze(-1), (0,)
    for position, cells, wraps in zip(positions, shape, periodic, strict=True):
        padded = ((position.remainder(cells) if wraps else position) + 1).clamp(0, cells + 1)
        lower = padded.detach().floor().clamp(max=cells)
        fraction = (padded - lower).unsqueeze(-1)
        spread = torch.stack([spread * (1 - fraction), spread * fraction], dim=-1).flatten(-2)
        row = row * (cells + 2) + lower.int().clamp_(min=0)  # as an int, a nan can be negative
        steps = tuple(step * (cells + 2) + high for step in steps for high in (0, 1))
    return Corners(row, spread, steps)


def sum_samples(
    table: Float[Tensor, "R C"], row: Int32[Tensor, "N K"], weights: Float[Tensor, "N K E"], steps: tuple[int, ...]
) -> Float[Tensor, "N C"]:
    """Return the sum of the K weighted samples of each sum; it has first derivatives by table and weights alone."""
    return _SumSamples.apply(table, row, weights, steps)  # type: ignore[return-value]


class _SumSamples(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, table: Tensor, row: Tensor, weights: Tensor, steps: tuple[int, ...]) -> Tensor:
        ctx.save_for_backward(table, row, weights)
        ctx.steps = steps
        return bag_sum(_corner_rows(row, steps), table, None, weights.flatten(1))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Any:
        table, row, weights = ctx.saved_tensors
        grad = grad.contiguous()
        grad_table = _table_gradient(grad, row, weights, ctx.steps, len(table)) if ctx.needs_input_grad[0] else None
        grad_weights = _weight_gradient(table, row, grad, ctx.steps) if ctx.needs_input_grad[2] else None
        return grad_table, None, grad_weights, None


def _corner_rows(row: Int32[Tensor, "N K"], steps: tuple[int, ...]) -> Int32[Tensor, "N KE"]:
    return (row.unsqueeze(-1) + torch.tensor(steps, dtype=row.dtype, device=row.device)).flatten(1)


def _table_gradient(
    grad: Float[Tensor, "N C"], row: Int32[Tensor, "N K"], weights: Tensor, steps: tuple[int, ...], size: int
) -> Float[Tensor, "R C"]:
    """Return the gradient of the table: the weighted gradient of each sum, added to the rows of its corners."""
    rows = row.flatten()
    order = rows.argsort()
    sources = torch.div(order, row.shape[1], rounding_mode="floor").int()
    sorted_weights = weights.flatten(0, 1).index_select(0, order)
    by_corner = (corner.contiguous() for corner in sorted_weights.unbind(1))
    return add_to_corners(grad, rows, sources, zip(steps, by_corner, strict=True), size)


def _weight_gradient(
    table: Float[Tensor, "R C"], row: Int32[Tensor, "N K"], grad: Float[Tensor, "N C"], steps: tuple[int, ...]
) -> Float[Tensor, "N K E"]:
    """Return the gradient of the weights: the inner product of each corner's row with the gradient of its sum."""
    parts = []
    for rows, grads in zip(row.split(CHUNK_SUMS), grad.split(CHUNK_SUMS), strict=True):
        columns = _corner_rows(rows, steps)
        ends = torch.arange(0, columns.numel() + 1, columns.shape[1], dtype=torch.int32, device=row.device)
        parts.append(inner_products(grads, table, ends, columns.flatten()))
    return torch.cat(parts).reshape(*row.shape, len(steps))
