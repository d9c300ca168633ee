"""Recall, precision and number of candidate voxels."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Bool, Float64, UInt8
from torch import Tensor

from omniocc.classes import FREE, UNKNOWN
from omniocc.geometry import Cuboid, Cylinder
from rayiou.bands import as_edges, band_of, band_suffixes, num_rows
from rayiou.checks import Array, as_tensors, check_grid, check_labels, check_mask, hash_of
from rayiou.cylinder import PAPER_RANGE_EDGES_M
from rayiou.plot import plot_scores
from rayiou.setting import CountMetric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COUNTS = ("found", "occupied", "known_candidates", "candidates", "cells")


def candidate_scores(counts: Float64[Tensor, "bands 5"], edges_m: Sequence[float]) -> dict[str, Tensor]:
    """Return the scores of counts; see `CandidateScores` for the keys. A score without cases is nan."""
    rows = {"": counts.sum(0)}
    rows |= dict(zip(band_suffixes(edges_m), counts, strict=False))  # the last row is no band
    scores = {}
    for suffix, (found, occupied, known, candidates, cells) in rows.items():
        scores |= {
            f"recall{suffix}": found / occupied,
            f"precision{suffix}": found / known,
            f"fraction{suffix}": candidates / cells,
        }
    return {key: value.float() for key, value in scores.items()}


class CandidateScores(CountMetric):
    """Recall, precision and fraction of candidate voxels over a dataset.

    Keys: `recall` (candidates among the occupied cells), `precision` (occupied cells among the candidates whose label
    is known) and `fraction` (candidates among all cells), over the whole grid; with `_<lower>-<upper>m` the same for
    each range band. The horizontal distance of its column's middle decides the band of a cell. Scores are ratios of
    sums over the dataset and all processes.

    Args:
        grid: the voxel grid.
        range_edges_m: ends of the range bands; a band holds its lower end and not its upper one.
        kwargs: those of every `torchmetrics.Metric`: `dist_sync_on_step`, `sync_on_compute` and so on.

    Raises:
        ValueError: if the ends do not increase.

    Example:
        >>> grid = Cylinder((2, 4, 1), (0.0, 4.0), (0.0, 1.0))
        >>> voxels = torch.zeros(1, 2, 4, 1, dtype=torch.uint8)
        >>> voxels[0, 1] = 3
        >>> candidates = torch.zeros(1, 2, 4, 1, dtype=torch.bool)
        >>> candidates[0, :, :3] = True
        >>> metric = CandidateScores(grid, (0.0, 4.0))
        >>> metric.update(candidates, voxels)
        >>> {key: value.item() for key, value in metric.compute().items() if "_" not in key}
        {'recall': 0.75, 'precision': 0.5, 'fraction': 0.75}
    """

    higher_is_better = None
    plot_upper_bound = 1.0
    counts: Tensor

    def __init__(
        self, grid: Cylinder | Cuboid, range_edges_m: Sequence[float | int] = PAPER_RANGE_EDGES_M, **kwargs: Any
    ):
        super().__init__(**kwargs)
        check_grid("grid", grid)
        self.grid = grid
        self.range_edges_m = as_edges(range_edges_m)
        self.add_setting(hash_of(repr((grid, self.range_edges_m)).encode()))
        zeros = torch.zeros(num_rows(self.range_edges_m), len(COUNTS), dtype=torch.float64)
        self.add_state("counts", zeros, dist_reduce_fx="sum")

    def update(self, preds: Bool[Array, "B X Y Z"], target: UInt8[Array, "B X Y Z"]) -> None:
        """Add the candidates and the true classes of a batch.

        Args:
            preds: whether each cell is a candidate.
            target: true class of every cell; 0 is free, 255 is unknown.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        preds, target = as_tensors(self.device, preds=preds, target=target)
        target = check_labels("target", target, self.grid.shape, UNKNOWN, UNKNOWN)
        check_mask("preds", preds, target.shape)
        known, occupied = target != UNKNOWN, (target != FREE) & (target != UNKNOWN)
        parts = [preds & occupied, occupied, preds & known, preds, torch.ones_like(preds)]
        columns = torch.stack([part.sum((0, 3)).flatten() for part in parts], dim=1).double()
        band = band_of(self.grid.distances_m().flatten(), self.range_edges_m)
        self.counts = self.counts.index_add(0, band.to(columns.device), columns)

    def compute(self) -> dict[str, Tensor]:
        """Return the scores over all frames."""
        return candidate_scores(self.counts, self.range_edges_m)

    def plot(
        self, val: dict[str, Tensor] | Sequence[dict[str, Tensor]] | None = None, ax: "Axes | None" = None
    ) -> "tuple[Figure, Axes]":
        """Draw recall, precision and fraction: bars for a result of `compute` (default: now), lines for a list of them.

        It needs matplotlib.
        """
        return plot_scores(self, ["recall", "precision", "fraction"], val, ax)
