"""Cross-entropy that counts voxels behind the first surface less, which no ray of the score reaches."""

import torch
from jaxtyping import Bool, Float, Float32, UInt8
from torch import Tensor
from torch.nn import functional as F

from omniocc.classes import FREE, UNKNOWN
from omniocc.geometry import Grid
from omniocc.loss.cross_entropy import CrossEntropy
from omniocc.loss.first_hit import RayCells, ray_cells, true_hits


def seen_cells(target: UInt8[Tensor, "B N"], rays: RayCells) -> Bool[Tensor, "B N"]:
    """Return which cells rays from the ego origin pass or hit, in the labels; unknown cells stop a ray too."""
    hits = true_hits(target, rays)
    end_m = torch.where(hits.labels == FREE, torch.inf, hits.entry_m)
    reached = rays.entry_m <= end_m[..., None]
    seen = target.new_zeros(len(target), target.shape[1] + 1)
    cells = rays.cells.flatten().expand(len(target), -1)
    return seen.scatter_reduce(1, cells, reached.flatten(1).to(seen.dtype), "amax")[:, :-1].bool()


class SeenFirst(CrossEntropy):
    """Cross-entropy weighted by class frequency and by sight.

    ALOcc and STCOcc count voxels that no camera sees less in training, since RayIoU does not look there.

    Args:
        constant: c in the class weights 1 / log(f + c), above 1.
        num_classes: C.
        geometry: grid of the voxels.
        azimuths: directions around the car; 39 rays, of different elevations, in each.
        hidden_weight: factor of the voxels that no ray passes or hits, in [0, 1].

    Raises:
        ValueError: if `constant` is not above 1, `azimuths` is not positive or `hidden_weight` is outside [0, 1].
    """

    cells: Tensor
    entry_m: Tensor

    def __init__(self, constant: float, num_classes: int, geometry: Grid, azimuths: int, hidden_weight: float):
        super().__init__(constant, num_classes)
        if azimuths < 1 or not 0 <= hidden_weight <= 1:
            raise ValueError(f"azimuths is {azimuths}, above 0; hidden_weight is {hidden_weight}, from 0 to 1")
        self.hidden_weight = hidden_weight
        for name, value in ray_cells(geometry, azimuths)._asdict().items():
            self.register_buffer(name, value, persistent=False)

    def forward(self, logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, ""]:
        """Return a scalar; 0 if no voxel is known or all weights are 0."""
        seen = seen_cells(target.flatten(1), RayCells(self.cells, self.entry_m)).view_as(target)
        labels = target.long()
        loss = F.cross_entropy(logits.float(), labels, ignore_index=UNKNOWN, reduction="none")
        weights = F.pad(self.weights, (0, UNKNOWN + 1 - len(self.weights)))[labels]
        weights = weights * torch.where(seen, 1.0, self.hidden_weight)
        return (weights * loss).sum() / weights.sum().clamp(min=torch.finfo(weights.dtype).tiny)
