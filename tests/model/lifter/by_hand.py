"""Geometry of lifters in plain loops, against which they are compared."""

import itertools
import math

import torch

from omniocc.geometry import Cylinder


def middle_of(grid, cell):
    """Return the ego point in the middle of a cell, (3,) float64, m."""
    first, second, third = (
        low + (index + 0.5) * (high - low) / cells
        for index, cells, (low, high) in zip(cell, grid.shape, grid.bounds, strict=True)
    )
    if isinstance(grid, Cylinder):
        first, second = first * math.cos(second), first * math.sin(second)
    return torch.tensor([first, second, third], dtype=torch.float64)


def bilinear(values, u, v):
    """Return the value of an image (h, w, C) at pixel (u, v), (C,); it is zero outside."""
    total = torch.zeros(values.shape[-1], dtype=values.dtype)
    for row, column in itertools.product((math.floor(v), math.floor(v) + 1), (math.floor(u), math.floor(u) + 1)):
        if 0 <= row < values.shape[0] and 0 <= column < values.shape[1]:
            total += (1 - abs(u - column)) * (1 - abs(v - row)) * values[row, column]
    return total
