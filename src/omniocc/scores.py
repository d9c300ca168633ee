"""One row of the results table: predictions scored against true voxels and against true LiDAR rays."""

from functools import partial
from typing import cast

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn
from torchmetrics import Metric, SumMetric

from omniocc.batch import Batch, Truth
from omniocc.classes import FREE
from omniocc.data import SourceSpec
from omniocc.geometry import Cuboid, Cylinder, Grid, sample_nearest
from omniocc.metric import RayIoU, RayTruth, VoxelIoU
from rayiou.ray_counts import TIMES

FINE_M = (0.25, 0.5, 1.0)
"""A second set of thresholds of RayIoU, ParkOcc's; m."""
BY_TIME = tuple(f"rayiou_{name}" for name in TIMES)
"""Scores of the rays from where the car was before, at and after the scored frame."""


def within_reach(
    labels: UInt8[Tensor, "B R"],
    range_m: Float[Tensor, "B R"],
    directions: Float[Tensor, "*B R 3"],
    reach_m: float,
    origins: Float[Tensor, "B R 3"] | None = None,
) -> UInt8[Tensor, "B R"]:
    """Return the classes of hits, free where the hit is `reach_m` or more away from the ego z axis.

    A ray with an infinite range keeps its label. A batch pads a frame without a scan with such rays, labelled unknown.
    Only the corners of a cuboid reach farther; without them, grids of any shape are scored on the same rays.
    """
    if origins is None:
        distance_m = range_m * directions[..., :2].norm(dim=-1)
    else:
        distance_m = (origins + range_m.unsqueeze(-1) * directions)[..., :2].norm(dim=-1)
    return labels.masked_fill((distance_m >= reach_m) & range_m.isfinite(), FREE)


def cells_between(grid: Grid, x_m: tuple[float, float], y_m: tuple[float, float]) -> Bool[Tensor, "1 X Y Z"]:
    """Return the cells of a grid whose middles lie between these ends along x and y."""
    x, y, _ = grid.centers(torch.float64).unbind(-1)
    return ((x > x_m[0]) & (x < x_m[1]) & (y > y_m[0]) & (y < y_m[1])).unsqueeze(0)


class Scores(nn.Module):
    """RayIoU against the true voxels (as the paper does), RayIoU against the LiDAR's true rays, and voxel IoU.

    `compute` uses the metrics' keys: plain for rays against voxels, `lidar/...` for true rays, `voxel/...` for cells.
    `fine/rayiou...` and `lidar/fine/rayiou...` score the same rays at `FINE_M` instead of 1, 2 and 4 m.
    LiDAR hits beyond the last band count as free on every grid; `lidar/left_out...` are the fractions of the LiDAR's
    rays that do not count (`omniocc.metric.RayIoU.left_out`). Where no batch has voxels or no LiDAR, their keys
    are absent. Where rays start from where the car was in past, present and future frames, `rayiou_past`, `rayiou_now`
    and `rayiou_future` are their scores apart.

    Where the source has a `Benchmark`, predictions are brought to the dataset's own grid first and scored there, from
    the dataset's own origins of rays; `voxel_<part>/...` are its nearer parts. Cells outside of `Batch.scored` count as
    unknown; where `Benchmark.masked_rays` is False, only in the scores of cells.
    """

    def __init__(self, geometry: Grid, spec: SourceSpec):
        super().__init__()
        self.geometry, self.benchmark = geometry, spec.benchmark
        self.grid = grid = cast(Cylinder | Cuboid, spec.scored_grid(geometry))
        parts = () if spec.benchmark is None else spec.benchmark.parts
        self.num_classes, self.reach_m = spec.classes.num_classes, spec.reach_m
        names, edges_m = spec.classes.names, spec.range_edges_m
        shared = {"range_edges_m": edges_m, "class_names": names, "fine_thresholds_m": FINE_M}
        ray_iou = partial(RayIoU, grid, self.num_classes, **shared)
        self.rays = ray_iou(split_origins=True, directions=spec.ray_directions)
        self.lidar = ray_iou(directions=spec.lidar_directions)
        self.cells = VoxelIoU(self.num_classes, class_names=names)
        self.part_cells = [(name, cells_between(grid, x_m, y_m)) for name, x_m, y_m in parts]
        self.parts = nn.ModuleList([VoxelIoU(self.num_classes, class_names=names) for _ in parts])
        self.voxel_frames, self.lidar_frames, self.timed_frames = SumMetric(), SumMetric(), SumMetric()
        directions = None if spec.lidar_directions is None else spec.lidar_directions.float()
        self.directions: Tensor | None
        self.register_buffer("directions", directions, persistent=False)

    def update(self, labels: UInt8[Tensor, "B X Y Z"], batch: Batch | Truth) -> None:
        """Add a batch of predicted labels on the grid of the model."""
        labels = sample_nearest(labels, self.geometry, self.grid)
        truth = batch.voxels if self.benchmark is None else batch.own_voxels
        self.voxel_frames.update(0 if truth is None else len(labels))
        self.timed_frames.update(0 if truth is None or batch.ray_times is None else len(labels))
        if truth is not None:
            self._add_voxels(labels, truth, batch)
        self.lidar_frames.update(0 if batch.lidar_labels is None else len(labels))
        if batch.lidar_labels is not None:
            self.lidar.update(labels, self.lidar_truth(batch))

    def lidar_truth(self, batch: Batch | Truth) -> RayTruth:
        """Return the LiDAR rays of a batch that has them; hits beyond the last band are free."""
        assert batch.lidar_range_m is not None
        assert batch.lidar_labels is not None
        directions = self.directions if batch.lidar_directions is None else batch.lidar_directions
        assert directions is not None
        range_m, origins = batch.lidar_range_m, batch.lidar_origins
        hits = within_reach(batch.lidar_labels, range_m, directions, self.reach_m, origins)
        return RayTruth(range_m, hits, batch.lidar_directions, origins)

    def compute(self) -> dict[str, Tensor]:
        """Return all scores, from counts over the dataset and all processes."""
        metrics = {"": self.rays, "lidar/": self.lidar, "voxel/": self.cells}
        pairs = zip(self.part_cells, self.parts, strict=True)
        metrics |= {f"voxel_{name}/": cast(VoxelIoU, part) for (name, _), part in pairs}
        counted = (self.voxel_frames, self.lidar_frames, self.timed_frames)
        voxels, lidar, timed = (frames.update_called and bool(frames.compute() > 0) for frames in counted)
        found = {f"lidar/{key}": value for key, value in self.lidar.left_out().items()} if lidar else {}
        return found | {
            f"{prefix}{key}": value
            for prefix, metric in metrics.items()
            if (lidar if prefix == "lidar/" else voxels)
            for key, value in metric.compute().items()
            if timed or key not in BY_TIME
        }

    def protocol(self) -> dict[str, str]:
        """Return how this process counted each kind of score, in one line each: `rayiou`, `lidar/rayiou`, `voxel`."""
        voxels = {"rayiou": self.rays.protocol(), "voxel": self.cells.protocol()} if self.rays.seen.given else {}
        beyond = f", and so are hits {self.reach_m:g} m or more from the ego z axis"
        return voxels | ({"lidar/rayiou": f"{self.lidar.protocol()}{beyond}"} if self.lidar.seen.given else {})

    def reset(self) -> None:
        """Reset all metrics."""
        for metric in self._metrics():
            metric.reset()

    def merge(self, other: "Scores") -> None:
        """Add the counts of other frames, which were scored by `other` in the same way."""
        for metric, more in zip(self._metrics(), other._metrics(), strict=True):
            metric.merge_state(more)

    def _metrics(self) -> list[Metric]:
        groups = (child if isinstance(child, nn.ModuleList) else [child] for child in self.children())
        return [metric for group in groups for metric in group if isinstance(metric, Metric)]

    def _add_voxels(self, labels: Tensor, truth: Tensor, batch: Batch | Truth) -> None:
        scored, origins, times = batch.scored, batch.ray_origins, batch.ray_times
        seen = scored if self.benchmark is None or self.benchmark.masked_rays else None
        if origins is None:
            self.rays.update(labels, truth, observed=seen)
        for sample, starts in enumerate(() if origins is None else origins):  # each has its own number of origins
            known, one = starts.isfinite().all(-1), slice(sample, sample + 1)
            if known.any():
                assert times is not None
                one_seen, when = None if seen is None else seen[one], times[one, known]
                self.rays.update(labels[one], truth[one], starts[known][None], one_seen, when)
        self.cells.update(labels, truth, observed=scored)
        for (_, cells), part in zip(self.part_cells, self.parts, strict=True):
            near = cells.to(labels.device).expand_as(truth)
            cast(VoxelIoU, part).update(labels, truth, observed=near if scored is None else near & scored)
