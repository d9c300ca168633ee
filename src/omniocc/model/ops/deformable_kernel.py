"""Deformable sampling on a CPU, compiled by numba: each sample is read once, and nothing but the sums is stored.

The functions correspond to those of `omniocc.model.ops.deformable_attention`, for one head and level. Positions, rows
and padding are described there in `Level`.
"""

from math import floor
from typing import no_type_check

import numpy as np
from torch import Tensor

from omniocc.compiled import compiled, run_in_threads
from omniocc.model.ops.visible import Pairs


@compiled
@no_type_check
def locate(anchor, offset, size):
    """Return lower pixel, fraction and whether the position is on the padded map; a NaN is at pixel 0."""
    raw = anchor + offset
    position = min(max(raw, np.float32(0)), np.float32(size - 1))
    lower = min(floor(position), size - 2)
    if not lower >= 0:  # NaN, whose fraction remains NaN
        lower = 0
        position = raw
    return lower, position - lower, raw == position


@compiled
@no_type_check
def add_samples(table, x, y, row, width, height, offsets, attention, query, total):
    """Add the weighted samples of all pairs to the rows of their queries in `total` (Q, C)."""
    for pair in range(len(query)):
        target = query[pair]
        for sample in range(x.shape[1]):
            column, fx, _ = locate(x[pair, sample], offsets[0, target, sample], width)
            line, fy, _ = locate(y[pair, sample], offsets[1, target, sample], height)
            corner = np.uint64(row[pair, sample] + line * width + column)
            below = corner + np.uint64(width)
            weight = attention[target, sample]
            lower = weight * fy
            upper = weight - lower
            right, low_right = upper * fx, lower * fx
            left, low_left = upper - right, lower - low_right
            for channel in range(table.shape[1]):
                total[target, channel] += (
                    left * table[corner, channel]
                    + right * table[corner + np.uint64(1), channel]
                    + low_left * table[below, channel]
                    + low_right * table[below + np.uint64(1), channel]
                )


@compiled
@no_type_check
def add_gradients(
    table, x, y, row, width, height, offsets, attention, query, grad, grad_table, grad_offsets, grad_attention
):  # fmt: skip
    """Add the gradients of all pairs' samples to those of table, offsets and attention."""
    products = np.empty(4, table.dtype)
    for pair in range(len(query)):
        target = query[pair]
        for sample in range(x.shape[1]):
            column, fx, inside_x = locate(x[pair, sample], offsets[0, target, sample], width)
            line, fy, inside_y = locate(y[pair, sample], offsets[1, target, sample], height)
            corner = np.uint64(row[pair, sample] + line * width + column)
            below = corner + np.uint64(width)
            weight = attention[target, sample]
            lower = weight * fy
            upper = weight - lower
            right, low_right = upper * fx, lower * fx
            left, low_left = upper - right, lower - low_right
            products[:] = 0
            for channel in range(table.shape[1]):
                value = grad[target, channel]
                products[0] += value * table[corner, channel]
                products[1] += value * table[corner + np.uint64(1), channel]
                products[2] += value * table[below, channel]
                products[3] += value * table[below + np.uint64(1), channel]
            for channel in range(table.shape[1]):
                value = grad[target, channel]
                grad_table[corner, channel] += left * value
                grad_table[corner + np.uint64(1), channel] += right * value
                grad_table[below, channel] += low_left * value
                grad_table[below + np.uint64(1), channel] += low_right * value
            upper_slope, lower_slope = products[1] - products[0], products[3] - products[2]
            top = products[0] + fx * upper_slope
            slope_y = products[2] + fx * lower_slope - top
            if inside_x:
                grad_offsets[0, target, sample] += (upper_slope + fy * (lower_slope - upper_slope)) * weight
            if inside_y:
                grad_offsets[1, target, sample] += slope_y * weight
            grad_attention[target, sample] += top + fy * slope_y


def sum_on_cpu(tables: list[Tensor], offsets: Tensor, attention: Tensor, pairs: Pairs, levels: list) -> Tensor:
    """Return what `deformable_sum` returns; heads are shared among threads."""
    heads, queries = offsets.shape[0], offsets.shape[3]
    total = tables[0].new_zeros(heads, queries, tables[0].shape[-1])
    parts = [_arrays(level) for level in levels]
    numbers = [value.detach().numpy() for value in (offsets, attention, pairs.query, total)]
    values = [table.detach().numpy() for table in tables]

    def work(first: int, last: int) -> None:
        for head in range(first, last):
            for index, (level, table) in enumerate(zip(parts, values, strict=True)):
                add_samples(
                    table[head], *level, numbers[0][head, index], numbers[1][head, index], numbers[2], numbers[3][head]
                )

    run_in_threads(work, heads, heads * pairs.query.numel())
    return total


def gradients_on_cpu(
    tables: list[Tensor], offsets: Tensor, attention: Tensor, pairs: Pairs, levels: list, grad: Tensor
) -> tuple[Tensor, Tensor, list[Tensor]]:
    """Return the gradients of offsets, attention and tables; heads and levels are shared among threads."""
    found = [value.new_zeros(value.shape) for value in (offsets, attention, *tables)]
    results = [value.numpy() for value in found]
    parts = [_arrays(level) for level in levels]
    inputs = [value.detach().numpy() for value in (offsets, attention, pairs.query, grad.contiguous())]
    values = [table.detach().numpy() for table in tables]
    places = [(head, index) for head in range(len(offsets)) for index in range(len(levels))]

    def work(first: int, last: int) -> None:
        for head, index in places[first:last]:
            add_gradients(
                values[index][head], *parts[index], inputs[0][head, index], inputs[1][head, index], inputs[2],
                inputs[3][head], results[2 + index][head], results[0][head, index], results[1][head, index],
            )  # fmt: skip

    run_in_threads(work, len(places), len(places) * pairs.query.numel())
    return found[0], found[1], found[2:]


def _arrays(level: tuple) -> tuple:
    """Return a level as the kernels take it."""
    x, y, row, width, height = level
    return x.contiguous().numpy(), y.contiguous().numpy(), row.contiguous().numpy(), width, height
