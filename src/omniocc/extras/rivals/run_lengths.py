"""Loss of run lengths: how many voxels with the same class follow in each direction (in the style of FoSOcc)."""

import torch
from jaxtyping import Bool, Float, Float32, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Weight
from omniocc.classes import UNKNOWN
from omniocc.geometry import Grid


def run_lengths(labels: UInt8[Tensor, "B X Y Z"], axis: int, wraps: bool) -> Int64[Tensor, "B X Y Z"]:
    """Return how many cells after each one, up along an axis (0, 1 or 2), have its label before another one comes.

    On an axis that wraps around, a run goes on at the other end and holds at most all other cells of the ring.
    """
    dim, cells = 1 + axis, labels.shape[1 + axis]
    changes = labels != labels.roll(-1, dim)
    if not wraps:
        changes.narrow(dim, cells - 1, 1).fill_(True)
    # on a ring a run may end in the second turn; the smallest place of a change from here on is its end
    turns = 2 if wraps else 1
    place = torch.arange(turns * cells, device=labels.device).view([-1 if other == dim else 1 for other in range(4)])
    beyond = turns * cells - 1
    last = torch.where(torch.cat([changes] * turns, dim), place, beyond)
    last = last.flip(dim).cummin(dim).values.flip(dim).narrow(dim, 0, cells)
    return (last - place.narrow(dim, 0, cells)).clamp(max=cells - 1)


def known_ends(
    labels: UInt8[Tensor, "B X Y Z"], lengths: Int64[Tensor, "B X Y Z"], axis: int, wraps: bool
) -> Bool[Tensor, "B X Y Z"]:
    """Return where a run up along an axis belongs to a known cell and does not end at an unknown one."""
    dim, cells = 1 + axis, labels.shape[1 + axis]
    place = torch.arange(cells, device=labels.device).view([-1 if other == dim else 1 for other in range(4)])
    stop = place + lengths + 1
    next_one = labels.gather(dim, stop % cells if wraps else stop.clamp(max=cells - 1))
    outside = torch.zeros_like(next_one, dtype=torch.bool) if wraps else stop >= cells
    return (labels != UNKNOWN) & ((next_one != UNKNOWN) | outside)


def six_runs(
    labels: UInt8[Tensor, "B X Y Z"], periodic: tuple[bool, bool, bool]
) -> tuple[Float32[Tensor, "B 6 X Y Z"], Bool[Tensor, "B 6 X Y Z"]]:
    """Return the run lengths as fractions of each axis's cells, and where they are known.

    Directions are up and down along the first axis, the second, the third.
    """
    fractions, known = [], []
    for axis, wraps in enumerate(periodic):
        for mirrored in (False, True):
            turned = labels.flip(1 + axis) if mirrored else labels
            lengths = run_lengths(turned, axis, wraps)
            found = lengths.float() / labels.shape[1 + axis], known_ends(turned, lengths, axis, wraps)
            fraction, there = (part.flip(1 + axis) if mirrored else part for part in found)
            fractions.append(fraction)
            known.append(there)
    return torch.stack(fractions, dim=1), torch.stack(known, dim=1)


class RunLengths(nn.Module):
    """Mean smooth L1 loss of the run lengths in six directions, with a weight for runs of length 0 and one for others.

    OccTrack360 (arXiv 2603.08521) weighs them 10 and 1,000. Lengths are fractions of the axis's cells. Runs of unknown
    cells, and runs that end at one, do not count.

    Args:
        geometry: grid of the voxels, which says which axes wrap around.
        zero_weight: factor of the loss where the true length is 0: the next voxel has another class.
        other_weight: factor of the loss of longer runs.

    Raises:
        ValueError: if a weight is negative.
    """

    def __init__(self, geometry: Grid, zero_weight: Weight, other_weight: Weight):
        super().__init__()
        if zero_weight < 0 or other_weight < 0:
            raise ValueError(f"weights are {zero_weight} and {other_weight}; they must not be negative")
        self.periodic = geometry.periodic
        self.zero_weight, self.other_weight = zero_weight, other_weight

    def forward(self, lengths: Float[Tensor, "B 6 X Y Z"], target: UInt8[Tensor, "B X Y Z"]) -> Float32[Tensor, ""]:
        """Return a scalar, from predicted fractions of each axis; 0 if no run is known."""
        true, known = six_runs(target, self.periodic)
        error = F.smooth_l1_loss(lengths.float(), true, reduction="none")
        weight = torch.where(true == 0, self.zero_weight, self.other_weight) * known
        return (error * weight).sum() / known.sum().clamp(min=1)
