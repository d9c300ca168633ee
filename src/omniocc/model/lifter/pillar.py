"""Bird's-eye-view queries that attend to the images along pillars (BEVFormer's spatial cross-attention)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.bounds import Count, Size
from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.lifter.coloring import Coloring
from omniocc.model.ops.blocks import coarsened
from omniocc.model.ops.padded import FeatureMaps
from omniocc.model.ops.padding import Axes
from omniocc.model.protocols import Sketched


def pillar_anchors(cells: int, heights: int) -> list[tuple[float, float, float]]:
    """Return reference points of a pillar of `cells` voxels, as offsets from its middle in pillars.

    They are spread evenly from the middle of the lowest voxel (where a single one is) to that of the highest.
    """
    places = torch.linspace(0.5, cells - 0.5, heights, dtype=torch.float64) / cells - 0.5
    return [(0.0, 0.0, place) for place in places.tolist()]


class Pillar(nn.Module):
    """Lift with one query per column of voxels, which attends to the cameras that see some of its heights.

    Li et al. (2022, 'BEVFormer', eq. 3 and 4): deformable attention around the projections of several points of each
    pillar, averaged over the cameras that see one. Each query then becomes the features of its voxels by a linear map,
    as in the occupancy head on BEVFormer. A pillar is a candidate if one of its voxels is. On a cylinder the bird's-eye
    view is polar. Other arguments as in `Coloring`.

    Args:
        in_channels: of image features and queries.
        channels: of the volume.
        heads: of attention, a divisor of `in_channels`.
        points: samples per head and level, a multiple of the heights, among which they are split.
        heights: reference points of each pillar.
        evidence: whether queries also start from the mean evidence of their column.

    Raises:
        ValueError: if the heads do not divide the channels, or the heights not the points.
    """

    def __init__(
        self,
        geometry: Grid,
        in_channels: Size,
        channels: Size,
        levels: list[int],
        layers: Count,
        heads: Count,
        points: Count,
        heights: Count,
        feedforward_channels: Size,
        evidence: bool = False,
    ):
        super().__init__()
        cells = geometry.shape[2]
        self.channels = channels
        self.block: Axes = (1, 1, cells)
        view, anchors = coarsened(geometry, self.block), pillar_anchors(cells, heights)
        self.coloring = Coloring(
            view,
            in_channels,
            levels,
            layers,
            heads,
            points,
            feedforward_channels=feedforward_channels,
            anchors=anchors,
            evidence=evidence,
        )
        self.raise_up = nn.Linear(in_channels, cells * channels)

    def forward(self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]) -> Float[Tensor, "B D X Y Z"]:
        """Lift each sample through its own rig."""
        view = self.coloring.color_blocks(features, sketched, rigs, self.block)[..., 0]
        # channels last in memory, which is fast in 3D convolutions
        return self.raise_up(view.movedim(1, -1)).unflatten(-1, (self.block[2], -1)).movedim(-1, 1)
