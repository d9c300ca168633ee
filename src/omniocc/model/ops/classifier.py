"""The last layer: logits of every voxel, which start from what is known before training."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.classes import FREE
from omniocc.geometry import Grid
from omniocc.model.ops.padding import Pointwise

SMOOTHING = 20.0
"""Frames by which the counts of a voxel's neighbours count in its own."""
FIRST_WEIGHTS = 0.01
"""Standard deviation of the linear map's first weights: small, so that the first logits are the start."""


class Classifier(nn.Module):
    """Add a linear map of the voxels' features to a start: the log-probabilities of the classes before training.

    The start has the frequencies of the classes in each voxel of the training frames. Hints may put a probability of
    their own in the place of the frequency of being occupied, and multiply the frequencies of the occupied classes. How
    much a frequency counts is learned for each class.

    Args:
        channels: of the volume.
        num_classes: of voxels, free included.

    Attributes:
        COUNTED: names of the buffers that are counted in the training frames, not learned.
    """

    COUNTED: ClassVar = ("prior_log_odds", "prior_shares")
    prior_log_odds: Tensor
    prior_shares: Tensor

    def __init__(self, geometry: Grid, channels: int, num_classes: int):
        super().__init__()
        self.geometry = geometry
        self.linear = Pointwise(channels, num_classes)
        nn.init.normal_(self.linear.weight, std=FIRST_WEIGHTS)
        nn.init.zeros_(self.linear.bias)
        self.prior_weight = nn.Parameter(torch.ones(num_classes - 1))
        self.register_buffer("prior_log_odds", torch.zeros(geometry.shape))
        self.register_buffer("prior_shares", torch.zeros(*geometry.shape, num_classes - 1))

    def set_class_counts(self, counts: Int64[Tensor, "K X Y Z"]) -> None:
        """Set the start from the number of training frames with each class in each voxel."""
        rings = [axis for axis in range(3) if self.geometry.periodic[axis]]
        occupied = smoothed_fractions(torch.stack([counts[FREE], counts[FREE + 1 :].sum(0)]), rings)
        self.prior_log_odds.copy_(torch.log(occupied[1] / occupied[0]))
        self.prior_shares.copy_(smoothed_fractions(counts[FREE + 1 :], rings).log().movedim(0, -1))

    def forward(self, volume: Float[Tensor, "B C X Y Z"], *hints: Tensor | None) -> Float[Tensor, "B K X Y Z"]:
        """Return logits; hints are those of `start`."""
        return self.linear(volume) + self.start(*hints).movedim(-1, 1)

    def start(
        self, log_odds: Float[Tensor, "B X Y Z"] | None = None, class_scores: Float[Tensor, "B X Y Z O"] | None = None
    ) -> Float[Tensor, "B X Y Z K"]:
        """Return the log-probabilities before any feature of the images is used.

        Args:
            log_odds: of being occupied; None: those of the training frames.
            class_scores: of the occupied classes, added to the logarithms of their frequencies; None: nothing is.
        """
        log_odds = self.prior_log_odds[None] if log_odds is None else log_odds
        scores = self.prior_weight * self.prior_shares[None]
        scores = scores if class_scores is None else scores + class_scores
        occupied = scores.log_softmax(-1) + F.logsigmoid(log_odds)[..., None]
        free = F.logsigmoid(-log_odds)[..., None]
        return torch.cat([free.expand(*occupied.shape[:-1], 1), occupied], dim=-1)


def smoothed_fractions(counts: Int64[Tensor, "K X Y Z"], rings: Sequence[int]) -> Float[Tensor, "K X Y Z"]:
    """Return the fraction of each class in each voxel, drawn towards that of its surroundings where frames are few.

    The surroundings of a voxel are its ring along the periodic axes, those of a ring its height, those of a height the
    whole grid, those of the grid equal fractions. Each is worth 20 frames. In a grid without periodic axes those of a
    voxel are its height.

    Args:
        counts: frames with each class in each voxel.
        rings: periodic axes of the grid.
    """
    fractions = torch.full((len(counts), 1, 1, 1), 1 / len(counts), dtype=torch.float64)
    wholes = [(1, 2, 3), (1, 2), *([tuple(axis + 1 for axis in rings)] if rings else []), ()]
    for axes in wholes:
        summed = counts.double().sum(axes, keepdim=True) if axes else counts.double()
        fractions = (summed + SMOOTHING * fractions) / (summed.sum(0, keepdim=True) + SMOOTHING)
    return fractions.float()
