"""`Coloring` on a coarser grid."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor, nn

from omniocc.bounds import Count, Size
from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.lifter.coloring import Coloring
from omniocc.model.ops.blocks import coarsened, repeat_blocks
from omniocc.model.ops.padded import FeatureMaps
from omniocc.model.ops.padding import Axes
from omniocc.model.ops.visible import CENTRE
from omniocc.model.protocols import Sketched


class CoarseColoring(nn.Module):
    """Lift with one query per block of voxels: `Coloring` on the coarser grid, copied to every voxel of a block.

    VoxFormer (Li et al., 2023) attends to the images and among voxels at half the resolution of its output. The refiner
    `Attention` with `halved` does the latter: the mean of a block of 2x2x2 equal voxels is the block's feature.
    A block is a candidate if one of its voxels is.
    Other arguments as in `Coloring`.

    Args:
        block: cells along each axis of a block.
        anchors: reference points of a block, as offsets from its centre in block sides, -0.5 to 0.5; see `Coloring`.
        evidence: whether queries also start from the mean evidence of their block.

    Raises:
        ValueError: if the grid does not divide into blocks, or as `Coloring`.
    """

    def __init__(
        self,
        geometry: Grid,
        channels: Size,
        levels: list[int],
        layers: Count,
        heads: Count,
        points: Count,
        feedforward_channels: Size,
        block: Count,
        anchors: Sequence[Sequence[float | int]] = CENTRE,
        evidence: bool = False,
    ):
        super().__init__()
        self.channels = channels
        self.block: Axes = (block, block, block)
        grid = coarsened(geometry, self.block)
        self.coloring = Coloring(
            grid,
            channels,
            levels,
            layers,
            heads,
            points,
            feedforward_channels=feedforward_channels,
            anchors=anchors,
            evidence=evidence,
        )

    def forward(self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]) -> Float[Tensor, "B C X Y Z"]:
        """Colour the blocks that hold candidates."""
        return repeat_blocks(self.coloring.color_blocks(features, sketched, rigs, self.block), self.block)
