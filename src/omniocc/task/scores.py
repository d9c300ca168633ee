"""One row of the results table: predictions scored against true voxels and against true LiDAR rays."""

from typing import cast

from torch import Tensor, nn

from omniocc.batch import Batch
from omniocc.geometry import Cuboid, Cylinder, Grid
from omniocc.metric import RayIoU, VoxelIoU

RANGE_EDGES_M = (0.0, 8.5, 17.0, 25.6)
"""The paper's distance bands (its Table 'result in different distance')."""


class Scores(nn.Module):
    """RayIoU against the true voxels (as the paper does), RayIoU against the ego LiDAR's true rays, and voxel IoU.

    The keys of `compute` are the metrics' own: plain for rays against voxels, `lidar/...` for true rays, `voxel/...`
    for cells.
    """

    def __init__(self, geometry: Grid):
        super().__init__()
        grid = cast(Cylinder | Cuboid, geometry)
        self.rays = RayIoU(grid, range_edges_m=RANGE_EDGES_M)
        self.lidar = RayIoU(grid, range_edges_m=RANGE_EDGES_M)
        self.cells = VoxelIoU()

    def update(self, labels: Tensor, batch: Batch) -> None:
        """Add a batch of predicted labels (B, *shape)."""
        self.rays.update(labels, batch.voxels)
        self.lidar.update_rays(labels, batch.lidar_range_m, batch.lidar_labels)
        self.cells.update(labels, batch.voxels)

    def compute(self) -> dict[str, Tensor]:
        """All results; counts are summed over the dataset and over processes before anything is divided."""
        parts = {"": self.rays, "lidar/": self.lidar, "voxel/": self.cells}
        return {f"{prefix}{key}": value for prefix, metric in parts.items() for key, value in metric.compute().items()}

    def reset(self) -> None:
        """Forget everything."""
        for metric in (self.rays, self.lidar, self.cells):
            metric.reset()
