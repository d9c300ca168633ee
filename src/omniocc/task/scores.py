"""One row of the results table: predictions scored against true voxels and against true LiDAR rays."""

from typing import cast

from jaxtyping import Float, UInt8
from torch import Tensor, nn

from omniocc.batch import Batch
from omniocc.classes import FREE
from omniocc.geometry import Cuboid, Cylinder, Grid
from omniocc.metric import RayIoU, VoxelIoU, sparseocc_directions
from omniocc.metric.bands import PAPER_RANGE_EDGES_M


def within_reach(
    labels: UInt8[Tensor, "B R"], range_m: Float[Tensor, "B R"], directions: Float[Tensor, "R 3"]
) -> UInt8[Tensor, "B R"]:
    """Classes of hits, free where the hit is beyond the last band, measured from the z axis.

    Only the corners of a cuboid reach farther: without them, grids of any outline are judged on the same rays.
    """
    distance_m = range_m * directions[:, :2].norm(dim=-1)
    return labels.masked_fill(distance_m >= PAPER_RANGE_EDGES_M[-1], FREE)


class Scores(nn.Module):
    """RayIoU against the true voxels (as the paper does), RayIoU against the ego LiDAR's true rays, and voxel IoU.

    The keys of `compute` are the metrics' own: plain for rays against voxels, `lidar/...` for true rays, `voxel/...`
    for cells. LiDAR hits beyond the last band count for no grid.
    """

    def __init__(self, geometry: Grid):
        super().__init__()
        grid = cast(Cylinder | Cuboid, geometry)
        self.rays = RayIoU(grid, range_edges_m=PAPER_RANGE_EDGES_M)
        self.lidar = RayIoU(grid, range_edges_m=PAPER_RANGE_EDGES_M)
        self.cells = VoxelIoU()
        self.directions: Tensor
        self.register_buffer("directions", sparseocc_directions().float(), persistent=False)

    def update(self, labels: Tensor, batch: Batch) -> None:
        """Add a batch of predicted labels (B, *shape)."""
        self.rays.update(labels, batch.voxels)
        hits = within_reach(batch.lidar_labels, batch.lidar_range_m, self.directions)
        self.lidar.update_rays(labels, batch.lidar_range_m, hits)
        self.cells.update(labels, batch.voxels)

    def compute(self) -> dict[str, Tensor]:
        """All results; counts are summed over the dataset and over processes before anything is divided."""
        parts = {"": self.rays, "lidar/": self.lidar, "voxel/": self.cells}
        return {f"{prefix}{key}": value for prefix, metric in parts.items() for key, value in metric.compute().items()}

    def reset(self) -> None:
        """Forget everything."""
        for metric in (self.rays, self.lidar, self.cells):
            metric.reset()
