"""Image features sampled at the cells of two grids (in the style of OneOcc)."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from omniocc.bounds import Size
from omniocc.camera import Rig
from omniocc.geometry import Grid, center_cell_indices
from omniocc.model.ops.padded import FeatureMaps
from omniocc.model.ops.padding import Pointwise
from omniocc.model.ops.voxel_samples import sample_at_voxels
from omniocc.model.protocols import Sketched


class BiGrid(nn.Module):
    """Sample image features at the middles of the cells of two grids, and bring them together in the first.

    In the style of OneOcc (arXiv 2511.03571): a feature is the bilinear sample at the projection of a cell's middle,
    averaged over the cameras that see it. Each voxel gets the features of its own cell and of the second grid's cell
    that its middle lies in, concatenated and mixed by a linear map. Features of all cells are sampled; candidates are
    ignored. Where no camera sees a cell, and beyond the second grid, features are zero.

    Args:
        second: the second grid, usually a cylinder beside a cuboid; None: one grid alone.
        in_channels: channels of the image features.
        channels: channels of the volume, and of the features of each grid.
        levels: strides of the feature maps, px, finest first; their features are summed.
    """

    index: Tensor
    """Cell of the second grid that the middle of each voxel lies in; the number of its cells where it is outside."""

    def __init__(self, geometry: Grid, second: Grid | None, in_channels: Size, channels: Size, levels: list[int]):
        super().__init__()
        self.channels, self.strides = channels, list(levels)
        self.grids = [geometry] if second is None else [geometry, second]
        self.maps = nn.ModuleList(
            nn.ModuleList(nn.Linear(in_channels, channels, bias=False) for _ in levels) for _ in self.grids
        )
        self.mix = Pointwise(channels * len(self.grids), channels)
        index = torch.empty(0, dtype=torch.int64) if second is None else center_cell_indices(second, geometry).long()
        self.register_buffer("index", index, persistent=False)

    def forward(self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]) -> Float[Tensor, "B D X Y Z"]:
        """Lift each sample through its own rig."""
        own, *others = (
            self._sample(features, grid, maps, rigs)  # type: ignore[arg-type]
            for grid, maps in zip(self.grids, self.maps, strict=True)
        )
        volumes = [own, *(resample_features(volume, self.index, own.shape[2:]) for volume in others)]
        return self.mix(torch.cat(volumes, dim=1))

    def _sample(
        self, features: FeatureMaps, grid: Grid, maps: nn.ModuleList, rigs: tuple[Rig, ...]
    ) -> Float[Tensor, "B D _ _ _"]:
        all_cells = torch.ones(len(rigs), *grid.shape, dtype=torch.bool, device=features[0].device)
        sampled = []
        for level, linear, stride in zip(features, maps, self.strides, strict=True):
            mapped = linear(level.movedim(2, -1)).movedim(-1, 2)
            sampled.append(sample_at_voxels(mapped, all_cells, rigs, grid, stride))
        return sum(sampled[1:], sampled[0])


def resample_features(
    volume: Float[Tensor, "B D U V W"], index: Int64[Tensor, " cells"], shape: torch.Size
) -> Float[Tensor, "B D X Y Z"]:
    """Return for each cell the features of cell `index` of another grid; zero where `index` is its number of cells."""
    rows = volume.movedim(1, -1).flatten(1, 3)
    rows = torch.cat([rows, rows.new_zeros(len(rows), 1, rows.shape[2])], dim=1)
    return rows[:, index].unflatten(1, shape).movedim(-1, 1)
