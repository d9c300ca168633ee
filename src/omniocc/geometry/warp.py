"""Trilinear interpolation along the axes of a grid."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

SNAP_CELLS = 1e-6
"""Positions this close to a cell centre count as the centre, so that a pose without motion changes no bit."""


def fold(index: Int64[Tensor, "..."], cells: int) -> Int64[Tensor, "..."]:
    """Takes indices of a periodic axis from within one turn of the grid back into it; cheaper than a remainder."""
    return index + cells * ((index < 0).long() - (index >= cells).long())


def trilinear(
    position: tuple[Float[Tensor, " N"], Float[Tensor, " N"], Float[Tensor, " N"]],
    shape: tuple[int, int, int],
    periodic: tuple[bool, bool, bool],
) -> tuple[Int64[Tensor, "N 8"], Float[Tensor, "N 8"], Bool[Tensor, " N"]]:
    """Finds the eight cells whose centres surround each point, with their weights.

    Args:
        position: points along each axis in units of cells (`Grid.coordinates`); float64 keeps a resting pose exact.
        shape: cells along each axis.
        periodic: which axes wrap around.

    Returns:
        Flat cell indices, weights that sum to 1 (border cells are repeated beyond the border), and whether the point is
        inside the grid.
    """
    weights = torch.ones_like(position[0]).unsqueeze(-1)
    flat = torch.zeros_like(weights, dtype=torch.int64)
    inside = torch.ones_like(position[0], dtype=torch.bool)
    for along, cells, wraps in zip(position, shape, periodic, strict=True):
        if not wraps:
            inside &= (along >= 0) & (along < cells)
        offset = (along - 0.5).clamp(-1, cells)
        nearest = offset.round()
        offset = torch.where((offset - nearest).abs() < SNAP_CELLS, nearest, offset)
        lower = offset.floor()
        pair = torch.stack([lower, lower + 1], dim=-1).long()
        pair = fold(pair, cells) if wraps else pair.clamp(0, cells - 1)
        fraction = offset - lower
        flat = (flat.unsqueeze(-1) * cells + pair.unsqueeze(-2)).flatten(1)
        weights = (weights.unsqueeze(-1) * torch.stack([1 - fraction, fraction], dim=-1).unsqueeze(-2)).flatten(1)
    return flat, weights, inside


def interpolate(
    features: Float[Tensor, "C M"], cells: Int64[Tensor, "N K"], weights: Float[Tensor, "N K"]
) -> Float[Tensor, "C N"]:
    """Weighted sum of K cells' features per point; differentiable in the features."""
    rows = features.T.contiguous()
    return torch.nn.functional.embedding_bag(cells, rows, per_sample_weights=weights, mode="sum").T
