"""Range bands: the intervals [lower, upper) of distance in which scores are given separately."""

import itertools
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from rayiou.checks import check_increasing


def as_edges(edges_m: Sequence[float | int] | None) -> tuple[float, ...]:
    """Return the checked ends of range bands; () for None: no bands.

    Raises:
        ValueError: if the ends are fewer than two or do not increase.
    """
    if edges_m is None:
        return ()
    edges = tuple(float(edge) for edge in edges_m)
    check_increasing("range_edges_m", edges, at_least=2)
    return edges


def num_rows(edges_m: Sequence[float]) -> int:
    """Return the rows of a table of sums by band: one for each band and a last one for all other distances."""
    return max(len(edges_m), 1)


def band_of(distance_m: Float[Tensor, " N"], edges_m: Sequence[float]) -> Int64[Tensor, " N"]:
    """Return the row of each distance (m) in a table with `num_rows` rows."""
    last = num_rows(edges_m) - 1
    edges = torch.tensor(list(edges_m) or [0.0], dtype=torch.float64, device=distance_m.device)
    band = torch.bucketize(distance_m.double(), edges, right=True) - 1
    return torch.where((band >= 0) & (band < last), band, last)


def band_suffixes(edges_m: Sequence[float]) -> list[str]:
    """Return `_<lower>-<upper>m` of each band, for the keys of scores."""
    return [f"_{low:g}-{high:g}m" for low, high in itertools.pairwise(edges_m)]
