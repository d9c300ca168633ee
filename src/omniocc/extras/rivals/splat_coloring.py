"""Lift-splat along true lens rays, then one pass of deformable attention (in the style of FoSOcc)."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.bounds import Count, Size
from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.lifter.coloring import Coloring
from omniocc.model.lifter.lift_splat import Interval, LiftSplat
from omniocc.model.ops.blocks import as_block, block_means, coarsened, repeat_blocks
from omniocc.model.ops.lenses import Lens, taken_for
from omniocc.model.ops.padded import FeatureMaps
from omniocc.model.ops.padding import Pointwise
from omniocc.model.protocols import Sketched


class SplatColoring(nn.Module):
    """Splat features along the cameras' own rays, then let blocks of the volume attend to the images.

    In the style of FoSOcc (OccTrack360, arXiv 2603.08521): `LiftSplat` fills the volume, whose blocks are the queries
    of `Coloring`; the features that they find are added to their voxels. Both use the exact lens model of every
    camera, at any angle. All voxels are filled; candidates are ignored.

    Args:
        in_channels: channels of image features and queries.
        channels: channels of the volume.
        levels: strides of the feature maps, px, finest first.
        bins: number of bins of range, of equal size.
        range_m: beginning of the first bin and end of the last one, along the ray.
        block: number of cells along each axis of a block, which is one query.
        layers: number of layers of cross-attention.
        heads: number of heads of attention, a divisor of `in_channels`.
        points: number of samples per head and level.
        feedforward_channels: hidden channels of the feed-forward part.
        lens: what the cameras are taken for, see `omniocc.model.ops.lenses`.

    Raises:
        ValueError: if the grid does not divide into blocks, or `LiftSplat` or `Coloring` refuses its arguments.
    """

    def __init__(
        self,
        geometry: Grid,
        in_channels: Size,
        channels: Size,
        levels: list[int],
        bins: Size,
        range_m: Interval,
        block: Sequence[Count],
        layers: Count,
        heads: Count,
        points: Count,
        feedforward_channels: Size,
        lens: Lens = "own",
    ):
        super().__init__()
        self.channels, self.block = channels, as_block(block)
        self.lens: Lens = lens
        block_grid = coarsened(geometry, self.block)
        self.splat = LiftSplat(geometry, in_channels, channels, levels, bins, range_m)
        self.reach_m = self.splat.reach_m
        self.query = Pointwise(channels, in_channels)
        self.coloring = Coloring(
            block_grid, in_channels, levels, layers, heads, points, feedforward_channels=feedforward_channels
        )
        self.found = Pointwise(in_channels, channels)

    def forward(self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]) -> Float[Tensor, "B D X Y Z"]:
        """Lift each sample through its own rig."""
        rigs = taken_for(self.lens, rigs)
        volume = self.splat(features, sketched, rigs)
        queries = self.query(block_means(volume, self.block))
        all_blocks = torch.ones(len(queries), *queries.shape[2:], dtype=torch.bool, device=queries.device)
        found = self.found(self.coloring.color(features, all_blocks, rigs, start=queries))
        return volume + repeat_blocks(found, self.block)

    def range_logits(self, features: FeatureMaps) -> Float[Tensor, "B N D h w"]:
        """Return the logits of the bins of range; see `LiftSplat.range_logits`."""
        return self.splat.range_logits(features)
