"""What candidate voxels find of what is there, and how many they are."""

import itertools
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float64, UInt8
from torch import Tensor
from torchmetrics import Metric

from omniocc.classes import FREE, UNKNOWN
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric.checks import check_increasing, check_labels, check_mask

COUNTS = ("found", "occupied", "true_or_free", "candidates", "cells")


def candidate_scores(counts: Float64[Tensor, "bins 5"], edges_m: Sequence[float]) -> dict[str, Tensor]:
    """Divides counts; see `Candidates` for the keys. What nothing can be said about is nan."""
    rows = {"": counts.sum(0)}
    rows |= {f"_{low:g}-{high:g}m": row for row, (low, high) in zip(counts, itertools.pairwise(edges_m), strict=False)}
    scores = {}
    for suffix, (found, occupied, known, candidates, cells) in rows.items():
        scores |= {
            f"recall{suffix}": found / occupied,
            f"precision{suffix}": found / known,
            f"share{suffix}": candidates / cells,
        }
    return {key: value.float() for key, value in scores.items()}


class Candidates(Metric):
    """Recall, precision and share of candidate voxels over a dataset.

    Keys: `recall` (occupied cells that are candidates), `precision` (candidates that are occupied, of those whose label
    is known) and `share` (candidates among all cells), over the whole grid; with `_<lower>-<upper>m` the same for each
    band of horizontal distance, to which a cell belongs by the middle of its column. Sums over dataset and processes
    are taken before anything is divided.

    Args:
        geometry: the voxel grid.
        range_edges_m: ends of the bands; the last ends are within the band.

    Raises:
        ValueError: if the edges do not increase.

    Example:
        >>> grid = Cylinder((2, 4, 1), (0.0, 4.0), (0.0, 1.0))
        >>> voxels = torch.zeros(1, 2, 4, 1, dtype=torch.uint8)
        >>> voxels[0, 1] = 3
        >>> candidates = torch.zeros(1, 2, 4, 1, dtype=torch.bool)
        >>> candidates[0, :, :3] = True
        >>> metric = Candidates(grid, (0.0, 4.0))
        >>> metric.update(candidates, voxels)
        >>> {key: value.item() for key, value in metric.compute().items() if "_" not in key}
        {'recall': 0.75, 'precision': 0.5, 'share': 0.75}
    """

    is_differentiable = False
    higher_is_better = None
    full_state_update = False
    counts: Tensor

    def __init__(self, geometry: Cylinder | Cuboid, range_edges_m: Sequence[float | int] = (0.0, 8.5, 17.0, 25.6)):
        super().__init__()
        self.geometry = geometry
        self.range_edges_m = tuple(float(edge) for edge in range_edges_m)
        check_increasing("range_edges_m", self.range_edges_m, at_least=2)
        bins = len(self.range_edges_m)  # the last: outside all bands
        self.add_state("counts", torch.zeros(bins, len(COUNTS), dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, candidates: Bool[Tensor, "B X Y Z"], voxels: UInt8[Tensor, "B X Y Z"]) -> None:
        """Adds the candidates and the true classes of a batch; 255 is unknown.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        voxels = check_labels("voxels", voxels, self.geometry.shape, UNKNOWN, UNKNOWN)
        check_mask("candidates", candidates, voxels.shape)
        known, occupied = voxels != UNKNOWN, (voxels != FREE) & (voxels != UNKNOWN)
        parts = [candidates & occupied, occupied, candidates & known, candidates, torch.ones_like(candidates)]
        columns = torch.stack([part.sum((0, 3)).flatten() for part in parts], dim=1).double()
        self.counts.index_add_(0, self._bands(columns.device), columns)

    def compute(self) -> dict[str, Tensor]:
        """Scores over everything seen."""
        return candidate_scores(self.counts, self.range_edges_m)

    def _bands(self, device: torch.device) -> Tensor:
        edges = torch.tensor(self.range_edges_m, dtype=torch.float64)
        band = torch.bucketize(self.geometry.distances_m().flatten(), edges, right=True) - 1
        outside = len(edges) - 1
        return torch.where(band < 0, outside, band).clamp(max=outside).to(device)
