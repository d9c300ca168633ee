"""Lifting from coarse to fine: only cells that are occupied or unsure are split (in the style of AdaptiveOcc)."""

import math
from collections.abc import Sequence
from typing import cast

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from omniocc.bounds import Count, Size
from omniocc.camera import Rig
from omniocc.classes import FREE
from omniocc.geometry import Grid
from omniocc.model.lifter.coloring import Coloring
from omniocc.model.lifter.lift_splat import Interval, LiftSplat
from omniocc.model.ops.blocks import coarsened, repeat_blocks
from omniocc.model.ops.padded import FeatureMaps
from omniocc.model.ops.padding import Axes, Pointwise, residual3d
from omniocc.model.protocols import CoarseLogits, Extras, Sketched

HALF: Axes = (2, 2, 2)


class CoarseToFine(nn.Module):
    """Lift coarse cells by splatting and attention, split some of them into 2x2x2, and attend again from the parts.

    In the style of AdaptiveOcc (ParkOcc). At each scale the cells attend to the images (`Coloring`), exchange what they
    found with their neighbours by a convolution, and are classified. Those that are occupied, or may be, are split; of
    more than `most` the likeliest. Cells that come from no split are not lifted again and keep the feature of the cell
    that they lie in. All cells of the coarsest scale are lifted; candidates of the sketch are ignored.

    Args:
        in_channels: of image features and queries.
        channels: of the volume.
        levels: strides of the feature maps, px, finest first.
        bins: of range, of equal size, of the splat at the coarsest scale.
        range_m: beginning of the first bin and end of the last one, along the ray.
        layers: of cross-attention at each scale, coarsest first; cells are half as long as those of the scale before.
        heads: of attention, a divisor of `in_channels`.
        points: samples per head and level at each scale.
        feedforward_channels: hidden channels of the feed-forward part.
        threshold: probability of being occupied from which on a cell is split, in [0, 1].
        most: largest fraction of the cells of each scale but the finest that is split, in (0, 1].
        num_classes: of the cells of all scales but the finest, free included.

    Raises:
        ValueError: if the numbers of scales differ, a fraction is out of range, or the grid cannot be halved often
            enough.
    """

    def __init__(
        self,
        geometry: Grid,
        in_channels: Size,
        channels: Size,
        levels: list[int],
        bins: Size,
        range_m: Interval,
        layers: list[Count],
        heads: Count,
        points: list[Count],
        feedforward_channels: Size,
        threshold: float,
        most: Sequence[float | int],
        num_classes: Size,
    ):
        super().__init__()
        if not layers or len(points) != len(layers) or len(most) != len(layers) - 1:
            sizes = f"layers {layers} and points {points} for each scale, most {list(most)} for each but the finest"
            raise ValueError(f"there must be {sizes}")
        if not 0 <= threshold <= 1 or any(not 0 < fraction <= 1 for fraction in most):
            raise ValueError(f"threshold is {threshold} and most {list(most)}; all must be fractions from 0 to 1")
        self.channels, self.threshold, self.most = channels, threshold, tuple(map(float, most))
        sides = [2**halvings for halvings in reversed(range(len(layers)))]
        self.sides = sides
        grids = [coarsened(geometry, (side, side, side)) for side in sides]
        self.splat = LiftSplat(grids[0], in_channels, in_channels, levels, bins, range_m)
        self.reach_m = self.splat.reach_m
        self.colorings = nn.ModuleList(
            Coloring(grid, in_channels, levels, depth, heads, samples, feedforward_channels=feedforward_channels)
            for grid, depth, samples in zip(grids, layers, points, strict=True)
        )
        self.mixers = nn.ModuleList(residual3d(in_channels, geometry.periodic) for _ in most)
        self.classifiers = nn.ModuleList(Pointwise(in_channels, num_classes) for _ in most)
        self.parts = nn.ModuleList(Pointwise(in_channels, in_channels) for _ in most)
        self.out = Pointwise(in_channels, channels)

    def forward(self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]) -> Float[Tensor, "B D X Y Z"]:
        """Lift each sample through its own rig."""
        return self.with_extras(features, sketched, rigs)[0]

    def with_extras(
        self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]
    ) -> tuple[Float[Tensor, "B D X Y Z"], Extras]:
        """Return the volume, and the logits of the cells of all scales but the finest, coarsest first."""
        start = self.splat(features, sketched, rigs)
        there = torch.ones(len(start), *start.shape[2:], dtype=torch.bool, device=start.device)
        coarse = []
        for scale, fraction in enumerate(self.most):
            volume = self.mixers[scale](self._lifted(scale, features, there, rigs, start))
            logits = self.classifiers[scale](volume)
            coarse.append(CoarseLogits(self.sides[scale], logits))
            # which cells are split has no gradient; the classifier learns from its logits alone
            split = cells_to_split(logits.detach(), there, self.threshold, fraction)
            there = repeat_blocks(split.unsqueeze(1), HALF).squeeze(1)
            start = repeat_blocks(self.parts[scale](volume), HALF)
        fine = self._lifted(len(self.most), features, there, rigs, start)
        return self.out(fine), Extras(tuple(coarse))

    def range_logits(self, features: FeatureMaps) -> Float[Tensor, "B N D h w"]:
        """Return scores of the bins; see `LiftSplat.range_logits`."""
        return self.splat.range_logits(features)

    def _lifted(
        self, scale: int, features: FeatureMaps, there: Bool[Tensor, "B x y z"], rigs: tuple[Rig, ...], start: Tensor
    ) -> Float[Tensor, "B C x y z"]:
        coloring = cast(Coloring, self.colorings[scale])
        return coloring.color(features, there, rigs, start=start)


def cells_to_split(
    logits: Float[Tensor, "B K x y z"], there: Bool[Tensor, "B x y z"], threshold: float, most: float
) -> Bool[Tensor, "B x y z"]:
    """Return the cells that are split: those of `there` whose probability of being occupied reaches the threshold.

    If that is more than the fraction `most` of all cells of the grid (rounded up), the likeliest are taken.
    """
    occupied = (1 - logits.float().softmax(1)[:, FREE]).flatten(1)
    eligible = there.flatten(1) & (occupied >= threshold)
    count = math.ceil(most * occupied.shape[1])
    # -1 is below every probability, so others fill up the count only where too few are eligible; `&` drops them again
    likeliest = occupied.masked_fill(~eligible, -1).topk(count, dim=1).indices
    chosen = torch.zeros_like(eligible).scatter(1, likeliest, torch.ones_like(eligible))
    return (chosen & eligible).view_as(there)
