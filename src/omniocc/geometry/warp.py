"""Trilinear interpolation along the axes of a grid."""

from typing import Protocol

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

SNAP_CELLS = 1e-6
"""Positions this close to a cell centre count as the centre, so that a pose without motion changes no bit."""


class Axes(Protocol):
    """The part of a grid that interpolation needs."""

    shape: tuple[int, int, int]

    @property
    def periodic(self) -> tuple[bool, bool, bool]: ...  # noqa: D102

    def coordinates(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]: ...  # noqa: D102


def trilinear(
    grid: Axes, points: Float[Tensor, "N 3"]
) -> tuple[Int64[Tensor, "N 8"], Float[Tensor, "N 8"], Bool[Tensor, " N"]]:
    """Finds the eight cells whose centres surround each point, with their weights.

    Args:
        grid: the grid to sample.
        points: ego frame, metres; float64 keeps the weights of a resting pose exact.

    Returns:
        Flat cell indices, weights that sum to 1 (border cells are repeated beyond the border), and whether the point is inside the grid.
    """
    flat = torch.zeros(len(points), 1, dtype=torch.int64, device=points.device)
    weights = points.new_ones(len(points), 1)
    inside = torch.ones(len(points), dtype=torch.bool, device=points.device)
    for position, cells, periodic in zip(grid.coordinates(points), grid.shape, grid.periodic, strict=True):
        if not periodic:
            inside &= (position >= 0) & (position < cells)
        position = (position - 0.5).clamp(-1, cells)
        nearest = position.round()
        position = torch.where((position - nearest).abs() < SNAP_CELLS, nearest, position)
        lower = position.floor()
        pair = torch.stack([lower, lower + 1], dim=-1).long()
        pair = pair.remainder(cells) if periodic else pair.clamp(0, cells - 1)
        fraction = position - lower
        flat = (flat.unsqueeze(-1) * cells + pair.unsqueeze(-2)).flatten(1)
        weights = (weights.unsqueeze(-1) * torch.stack([1 - fraction, fraction], dim=-1).unsqueeze(-2)).flatten(1)
    return flat, weights, inside


def interpolate(
    features: Float[Tensor, "C M"], cells: Int64[Tensor, "N K"], weights: Float[Tensor, "N K"]
) -> Float[Tensor, "C N"]:
    """Weighted sum of K cells' features per point; differentiable in the features."""
    rows = features.T.contiguous()
    return torch.nn.functional.embedding_bag(cells, rows, per_sample_weights=weights, mode="sum").T
