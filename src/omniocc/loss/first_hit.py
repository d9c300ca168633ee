"""Losses of the first hits of rays, which RayIoU scores, as functions of the probabilities of all voxels on the way."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Size, Weight
from omniocc.classes import FREE, UNKNOWN
from omniocc.geometry import Grid
from rayiou.directions import rays_around

LEAST = 1e-3
"""Added to the probability of a correct hit in its logarithm, so that single rays cannot dominate."""


class RayCells(NamedTuple):
    """The cells on rays from the ego origin, nearest first.

    Attributes:
        cells: flat index; the number of the grid's cells after the last one.
        entry_m: distance at which each is entered.
    """

    cells: Int64[Tensor, "R L"]
    entry_m: Float[Tensor, "R L"]


class TrueHits(NamedTuple):
    """The first occupied cell on each ray, in the labels.

    Attributes:
        labels: its class; free for no hit.
        entry_m: distance at which it is entered.
    """

    labels: UInt8[Tensor, "B R"]
    entry_m: Float[Tensor, "B R"]


class FirstHits(NamedTuple):
    """What the first hits of rays are, if every voxel is occupied with its own probability.

    Attributes:
        correct: probability that the ray hits the true class within each distance of the true hit; 0 without true hit.
        predicted: expected number of rays that hit each class, over the rays with a true hit.
        labels: true class of each ray's hit; free where the truth has none or is unknown.
    """

    correct: Float32[Tensor, "D B R"]
    predicted: Float32[Tensor, "B C"]
    labels: UInt8[Tensor, "B R"]


def ray_cells(grid: Grid, azimuths: int) -> RayCells:
    """Return the cells on 39 elevations of rays, those of the public RayIoU, in `azimuths` directions each."""
    directions = rays_around(azimuths)
    paths = grid.paths(torch.zeros_like(directions), directions)
    cells = torch.where(paths.cells < 0, grid.num_cells, paths.cells.long())
    return RayCells(cells, paths.entry_m.nan_to_num(nan=torch.inf))


def true_hits(target: UInt8[Tensor, "B N"], rays: RayCells) -> TrueHits:
    """Return the first cells that are not free; unknown cells stop a ray too."""
    along = F.pad(target, (0, 1), value=FREE)[:, rays.cells]
    first = (along != FREE).byte().argmax(-1, keepdim=True)
    entry_m = rays.entry_m.expand(along.shape).gather(-1, first)
    return TrueHits(along.gather(-1, first).squeeze(-1), entry_m.squeeze(-1))


def first_hits(
    logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"], rays: RayCells, within_m: Sequence[float]
) -> FirstHits:
    """Return the probabilities of the rays' first hits; `within_m` are the distances that count as correct."""
    logarithm = F.pad(logits.float().flatten(2).log_softmax(1), (0, 1))
    passed = logarithm[:, FREE, rays.cells]
    reached = (passed.cumsum(-1) - passed).exp()
    truth = true_hits(target.flatten(1), rays)
    known = (truth.labels != FREE) & (truth.labels != UNKNOWN)
    labels = truth.labels.where(known, FREE)
    number = logarithm.shape[2]
    own = logarithm.flatten(1).gather(1, (labels.long()[..., None] * number + rays.cells).flatten(1))
    hit = reached * own.view_as(reached).exp() * (rays.cells < number - 1) * known[..., None]
    error_m = (rays.entry_m - truth.entry_m[..., None]).abs()
    correct = torch.stack([(hit * (error_m <= limit_m)).sum(-1) for limit_m in within_m])
    counted = (reached * known[..., None]).flatten(1)
    arriving = logits.new_zeros(len(logits), number, dtype=torch.float32)
    arriving = arriving.index_add(1, rays.cells.flatten(), counted)[:, :-1]
    return FirstHits(correct, torch.einsum("bcn,bn->bc", logarithm[..., :-1].exp(), arriving), labels)


def unlikely(hits: FirstHits) -> Float32[Tensor, ""]:
    """Return -log of the probability that a first hit is correct: mean over rays with a true hit, and distances."""
    known = hits.labels != FREE
    return -((hits.correct + LEAST).log() * known).sum() / (known.sum() * len(hits.correct)).clamp(min=1)


def missed_overlap(hits: FirstHits) -> Float32[Tensor, ""]:
    """Return 1 - RayIoU of the probabilities: mean over the classes that true hits of the batch have, and distances."""
    number = torch.arange(hits.predicted.shape[1], dtype=torch.uint8, device=hits.labels.device)
    one_hot = (hits.labels[..., None] == number).float()
    correct = torch.einsum("dbr,brc->dc", hits.correct, one_hot)
    true, predicted = one_hot.sum((0, 1)), hits.predicted.sum(0)
    present = (true > 0) & (number != FREE)
    wrong = torch.where(present, 1 - correct / (true + predicted - correct).clamp(min=1e-6), 0)
    return wrong.sum() / (present.sum() * len(hits.correct)).clamp(min=1)


class FirstHit(nn.Module):
    """Add `unlikely` and `missed_overlap` of the first hits of rays, by weight; 0 if no ray has a true hit.

    Args:
        geometry: grid of the voxels.
        azimuths: directions around the car; 39 rays, of different elevations, in each.
        within_m: distances from the true hit that count as correct, one after the other.
        likelihood_weight: of -log of the probability that the first hit is correct.
        overlap_weight: of 1 - RayIoU of the probabilities.

    Raises:
        ValueError: if there are no azimuths or distances.
    """

    cells: Tensor
    entry_m: Tensor

    def __init__(
        self,
        geometry: Grid,
        azimuths: Size,
        within_m: Sequence[float],
        likelihood_weight: Weight,
        overlap_weight: Weight,
    ):
        super().__init__()
        if azimuths < 1 or not within_m or min(within_m) <= 0:
            raise ValueError(f"azimuths is {azimuths}, within_m {list(within_m)}; both need positive values")
        self.within_m = tuple(float(limit_m) for limit_m in within_m)
        self.likelihood_weight, self.overlap_weight = likelihood_weight, overlap_weight
        for name, value in ray_cells(geometry, azimuths)._asdict().items():
            self.register_buffer(name, value, persistent=False)

    def forward(self, logits: Float[Tensor, "B C *grid"], target: UInt8[Tensor, "B *grid"]) -> Float32[Tensor, ""]:
        """Return a scalar, computed in float32 also under autocast."""
        with torch.autocast(logits.device.type, enabled=False):
            hits = first_hits(logits, target, RayCells(self.cells, self.entry_m), self.within_m)
            return self.likelihood_weight * unlikely(hits) + self.overlap_weight * missed_overlap(hits)
