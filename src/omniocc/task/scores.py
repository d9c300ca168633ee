"""One row of the results table: predictions scored against true voxels and against true LiDAR rays."""

from functools import partial
from typing import cast

from jaxtyping import Float, UInt8
from torch import Tensor, nn
from torchmetrics import SumMetric

from omniocc.batch import Batch, Truth
from omniocc.classes import FREE
from omniocc.data import SourceSpec
from omniocc.geometry import Cuboid, Cylinder, Grid
from omniocc.metric import RayIoU, RayTruth, VoxelIoU


def within_reach(
    labels: UInt8[Tensor, "B R"],
    range_m: Float[Tensor, "B R"],
    directions: Float[Tensor, "*B R 3"],
    reach_m: float,
    origins: Float[Tensor, "B R 3"] | None = None,
) -> UInt8[Tensor, "B R"]:
    """Return the classes of hits, free where the hit is `reach_m` or more away from the ego z axis.

    Only the corners of a cuboid reach farther; without them, grids of any shape are scored on the same rays.
    """
    if origins is None:
        distance_m = range_m * directions[..., :2].norm(dim=-1)
    else:
        distance_m = (origins + range_m.unsqueeze(-1) * directions)[..., :2].norm(dim=-1)
    return labels.masked_fill(distance_m >= reach_m, FREE)


class Scores(nn.Module):
    """RayIoU against the true voxels (as the paper does), RayIoU against the LiDAR's true rays, and voxel IoU.

    `compute` uses the metrics' keys: plain for rays against voxels, `lidar/...` for true rays, `voxel/...` for cells.
    LiDAR hits beyond the last band count as free on every grid. Where no batch has voxels or no LiDAR, their keys
    are absent; cells outside `Batch.scored` count as unknown.
    """

    def __init__(self, geometry: Grid, spec: SourceSpec):
        super().__init__()
        grid = cast(Cylinder | Cuboid, geometry)
        self.num_classes, self.reach_m = spec.classes.num_classes, spec.reach_m
        names, edges_m = spec.classes.names, spec.range_edges_m
        ray_iou = partial(RayIoU, grid, self.num_classes, range_edges_m=edges_m, class_names=names)
        self.rays, self.lidar = ray_iou(), ray_iou(directions=spec.lidar_directions)
        self.cells = VoxelIoU(self.num_classes, class_names=names)
        self.voxel_frames, self.lidar_frames = SumMetric(), SumMetric()
        directions = None if spec.lidar_directions is None else spec.lidar_directions.float()
        self.directions: Tensor | None
        self.register_buffer("directions", directions, persistent=False)

    def update(self, labels: UInt8[Tensor, "B X Y Z"], batch: Batch | Truth) -> None:
        """Add a batch of predicted labels."""
        self.voxel_frames.update(0 if batch.voxels is None else len(labels))
        if batch.voxels is not None:
            self.rays.update(labels, batch.voxels, observed=batch.scored)
            self.cells.update(labels, batch.voxels, observed=batch.scored)
        self.lidar_frames.update(0 if batch.lidar_labels is None else len(labels))
        if batch.lidar_labels is not None:
            self._add_lidar(labels, batch)

    def compute(self) -> dict[str, Tensor]:
        """Return all scores, from counts over the dataset and all processes."""
        parts = {"": self.rays, "lidar/": self.lidar, "voxel/": self.cells}
        frames = {"": self.voxel_frames, "lidar/": self.lidar_frames, "voxel/": self.voxel_frames}
        return {
            f"{prefix}{key}": value
            for prefix, metric in parts.items()
            if frames[prefix].compute() > 0
            for key, value in metric.compute().items()
        }

    def reset(self) -> None:
        """Reset all metrics."""
        for metric in (self.rays, self.lidar, self.cells, self.voxel_frames, self.lidar_frames):
            metric.reset()

    def _add_lidar(self, labels: Tensor, batch: Batch | Truth) -> None:
        assert batch.lidar_range_m is not None
        assert batch.lidar_labels is not None
        directions = self.directions if batch.lidar_directions is None else batch.lidar_directions
        assert directions is not None
        range_m, origins = batch.lidar_range_m, batch.lidar_origins
        hits = within_reach(batch.lidar_labels, range_m, directions, self.reach_m, origins)
        self.lidar.update(labels, RayTruth(range_m, hits, batch.lidar_directions, origins))
