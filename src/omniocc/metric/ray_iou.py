"""RayIoU: occupancy scored by what LiDAR rays would hit first (SparseOcc, Liu et al. 2024), on any grid."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor
from torchmetrics import Metric

from omniocc.classes import CLASSES, FREE, NUM_CLASSES, UNKNOWN
from omniocc.geometry import Cuboid, Cylinder, Hits, RayTable, Scan, ray_table
from omniocc.metric.checks import check_classes, check_increasing, check_labels, check_mask, check_same_batch
from omniocc.metric.directions import sparseocc_directions
from omniocc.metric.plot import plot_bars
from omniocc.metric.ray_counts import RayCounts, count_rays, ray_scores

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class RayTruth(NamedTuple):
    """What real LiDAR rays saw: truth without a grid; see `RayIoU.update_rays`.

    Attributes:
        range_m: distance along each ray, inf where nothing is hit; the rays are the metric's directions from each
            origin in turn.
        labels: class of what is hit; free where nothing is hit.
    """

    range_m: Float[Tensor, "B R"]
    labels: Shaped[Tensor, "B R"]


class RayIoU(Metric):
    """RayIoU over a dataset, with the public protocol's counting.

    A ray counts if its true first hit is of a class other than free and unknown. It is correct at a threshold if the
    predicted first hit has the same class and lies at a distance that differs by less than the threshold. Counts are
    summed over rays, frames and processes; IoU = correct / (true + predicted - correct) for each class and threshold,
    and the mean runs over thresholds and over the classes present. A ray that never meets the grid is invalid (the
    public script takes voxel (0, 0, 0) for it).

    The paper does not say which thresholds, rays and origins it used. The default here is the mean over 1, 2 and 4 m of
    the public 39 x 360 rays from an ego LiDAR at the ego origin. Range bins go by the true distance along the ray.
    `docs/rayiou.md` compares all this with the public script.

    Args:
        geometry: grid of the predictions.
        num_classes: number of classes, free included.
        free_class: id of free space.
        ignore_class: id of unknown cells in the target; rays whose true first hit is unknown are dropped.
        thresholds_m: the mean runs over these.
        range_edges_m: ends of the range bins; none for no bins.
        directions: (D, 3) rays in the ego frame; default `sparseocc_directions()`.
        target_geometry: grid of the targets, if another one. Rays whose true hit lies outside the prediction's grid
            are dropped.
        hit: distance of a hit: where the ray leaves the cell hit (the public protocol) or where it enters it.
        count_free_rays: also count rays whose truth is free, so that what is predicted on them costs its class, at the
            distance at which the ray leaves the grid. The public protocol drops them: hallucinations go unpunished.

    Raises:
        ValueError: if an argument makes no sense.

    Example:
        >>> grid = Cylinder((32, 50, 4), (0.0, 12.8), (-2.8, 3.6))
        >>> target = torch.zeros(1, 32, 50, 4, dtype=torch.uint8)
        >>> target[..., 0] = 1
        >>> target[:, 26] = 4  # a round building, 10.4 to 10.8 m away
        >>> metric = RayIoU(grid)
        >>> metric.update(target.roll(3, dims=1), target)  # found 1.2 m too far
        >>> [round(metric.compute()[key].item(), 2) for key in ("rayiou", "rayiou@1", "rayiou@2", "rayiou/Building")]
        [0.77, 0.44, 0.93, 0.65]
    """

    is_differentiable = False
    higher_is_better = True
    full_state_update = False
    truth: Tensor
    predicted: Tensor
    correct: Tensor

    def __init__(
        self,
        geometry: Cylinder | Cuboid,
        num_classes: int = NUM_CLASSES,
        free_class: int = FREE,
        ignore_class: int = UNKNOWN,
        thresholds_m: Sequence[float | int] = (1.0, 2.0, 4.0),
        range_edges_m: Sequence[float | int] | None = None,
        directions: Float[Tensor, "D 3"] | None = None,
        target_geometry: Cylinder | Cuboid | None = None,
        hit: Literal["exit", "entry"] = "exit",
        count_free_rays: bool = False,
    ):
        super().__init__()
        check_classes(num_classes, free_class, ignore_class)
        if hit not in ("exit", "entry"):
            raise ValueError(f"hit must be 'exit' or 'entry', got {hit!r}")
        self.geometry, self.target_geometry = geometry, target_geometry or geometry
        self.num_classes, self.free_class, self.ignore_class = num_classes, free_class, ignore_class
        self.thresholds_m = tuple(float(edge) for edge in thresholds_m)
        check_increasing("thresholds_m", self.thresholds_m, at_least=1)
        self.range_edges_m = tuple(float(edge) for edge in range_edges_m or ())
        if range_edges_m is not None:
            check_increasing("range_edges_m", self.range_edges_m, at_least=2)
        self.hit, self.count_free_rays = hit, count_free_rays
        self.scan = Scan(sparseocc_directions() if directions is None else directions)
        bins, thresholds = max(len(self.range_edges_m), 1), len(self.thresholds_m)
        zeros = torch.zeros(bins, num_classes, dtype=torch.int64)
        self.add_state("truth", zeros, dist_reduce_fx="sum")
        self.add_state("predicted", zeros.clone(), dist_reduce_fx="sum")
        self.add_state("correct", zeros.unsqueeze(1).repeat(1, thresholds, 1), dist_reduce_fx="sum")

    def update(
        self,
        prediction: Shaped[Tensor, "B *grid"],
        target: Shaped[Tensor, "Bt *target_grid"] | RayTruth,
        origins: Float[Tensor, "*places 3"] | None = None,
        observed: Shaped[Tensor, "Bo *observed_grid"] | None = None,
    ) -> None:
        """Adds predicted and true class ids of a batch.

        Args:
            prediction: (B, *geometry.shape) class of every cell; any integer type, or whole numbers in a floating one.
            target: (B, *target_geometry.shape) true class of every cell, or `ignore_class`. Or what real rays saw: see
                `update_rays`.
            origins: (B, O, 3) places in the ego frame (metres) that the rays start from; default the ego origin. Those
                of the public protocol: `eight_origins`.
            observed: bool, as the target: cells that count; the others are unknown.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        prediction = check_labels("prediction", prediction, self.geometry.shape, self.num_classes)
        if origins is not None and (origins.ndim != 3 or len(origins) != len(prediction) or origins.shape[2] != 3):
            raise ValueError(f"origins must have shape ({len(prediction)}, O, 3), got {tuple(origins.shape)}")
        places = torch.zeros(1, 3).expand(len(prediction), 1, 3) if origins is None else origins
        places = places.to(prediction.device)
        if isinstance(target, RayTruth):
            self._check_rays(prediction, target, places)
            for sample in zip(prediction, target.range_m, target.labels, places, strict=True):
                self._add_rays(*sample)
            return
        target = check_labels("target", target, self.target_geometry.shape, self.num_classes, self.ignore_class)
        check_same_batch("prediction", prediction, "target", target)
        check_mask("observed", observed, target.shape)
        if observed is not None:
            target = target.masked_fill(~observed, self.ignore_class)
        for sample in zip(prediction, target, places, strict=True):
            self._add_voxels(*sample)

    def update_rays(
        self,
        prediction: Shaped[Tensor, "B X Y Z"],
        range_m: Float[Tensor, "B R"],
        labels: Shaped[Tensor, "B R"],
        origins: Float[Tensor, "B O 3"] | None = None,
    ) -> None:
        """Adds predicted class ids of a batch against what real LiDAR rays saw, with no grid on the side of the truth.

        A voxel only says that something is in it, not where, so the error of a ray is the distance from the true range
        to the stretch of the ray inside the predicted cell: 0 if the true point lies in it. (`hit` is for voxels
        against voxels, where both sides share the bias.) A ray that hit nothing, or a point outside the grid, is free
        in truth, and is dropped unless `count_free_rays`; it says nothing about what lies behind its point.

        Args:
            prediction: class of every cell.
            range_m: see `RayTruth`.
            labels: see `RayTruth`.
            origins: as in `update`.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        self.update(prediction, RayTruth(range_m, labels), origins)

    def compute(self) -> dict[str, Tensor]:
        """Scores over everything seen: see `omniocc.metric.ray_counts.ray_scores` for the keys."""
        counts = RayCounts(self.truth, self.predicted, self.correct)
        known = self.num_classes == NUM_CLASSES
        names = [CLASSES[c].name if known else str(c) for c in range(self.num_classes)]
        return ray_scores(counts, names, self.free_class, self.thresholds_m, self.range_edges_m)

    def plot(
        self,
        val: dict[str, Tensor] | None = None,
        ax: "Axes | None" = None,
        by: Literal["class", "threshold", "range"] = "class",
    ) -> "tuple[Figure, Axes]":
        """Draws scores as bars (needs matplotlib).

        Args:
            val: what `compute` returned; default now.
            ax: where to draw; default a new figure.
            by: one bar for each class, threshold or range bin.
        """
        scores = self.compute() if val is None else val
        prefix = {"class": "rayiou/", "threshold": "rayiou@", "range": "rayiou_"}[by]
        return plot_bars(scores, [key for key in scores if key.startswith(prefix)], ax)

    def _check_rays(self, prediction: Tensor, target: RayTruth, places: Tensor) -> None:
        rays = len(self.scan) * places.shape[1]
        check_labels("labels", target.labels, (rays,), self.num_classes, self.ignore_class)
        check_same_batch("prediction", prediction, "labels", target.labels)
        if target.range_m.shape != target.labels.shape:
            shapes = f"{tuple(target.labels.shape)}, got {tuple(target.range_m.shape)}"
            raise ValueError(f"range_m must have shape {shapes}")

    def _add_voxels(self, prediction: Tensor, target: Tensor, places: Float[Tensor, "O 3"]) -> None:
        if self.target_geometry == self.geometry:
            found, truth = self._cast(ray_table(self.geometry, places, self.scan), prediction, target)
        else:
            found = self._cast(ray_table(self.geometry, places, self.scan), prediction)[0]
            truth = self._cast(ray_table(self.target_geometry, places, self.scan), target)[0]
        free = truth.labels == self.free_class
        valid = ~free
        if self.target_geometry != self.geometry:
            valid &= self._inside(places, (truth.entry_m.double() + truth.exit_m) / 2)
        true_m, predicted_m = (hits.entry_m if self.hit == "entry" else hits.exit_m for hits in (truth, found))
        if self.count_free_rays:
            valid |= free & self._clear(found, truth.exit_m)
        self._add(truth.labels, true_m, found.labels, (true_m - predicted_m).abs(), valid)

    def _add_rays(self, prediction: Tensor, range_m: Tensor, labels: Tensor, places: Float[Tensor, "O 3"]) -> None:
        table = ray_table(self.geometry, places, self.scan)
        found = self._cast(table, prediction)[0]
        range_m, labels = range_m.double(), labels.to(torch.uint8)
        error_m = torch.maximum(found.entry_m - range_m, range_m - found.exit_m).clamp(min=0)
        valid = (labels != self.free_class) & self._inside(places, range_m)
        if self.count_free_rays:
            leave_m = table.reach_m
            free = ((labels == self.free_class) | (range_m >= leave_m)) & (labels != self.ignore_class)
            clear_m = torch.minimum(range_m, leave_m.double())
            valid |= free & self._clear(found, clear_m)
            labels, range_m = labels.masked_fill(free, self.free_class), torch.where(free, clear_m, range_m)
        self._add(labels, range_m, found.labels, error_m, valid)

    def _cast(self, table: RayTable, *volumes: Tensor) -> list[Hits]:
        # uint8 wraps around, so the free class becomes 0 and no other one does
        hits = table.cast_all([labels - self.free_class for labels in volumes])
        return [found._replace(labels=found.labels + self.free_class) for found in hits]

    def _inside(self, places: Float[Tensor, "O 3"], range_m: Float[Tensor, " R"]) -> Bool[Tensor, " R"]:
        """Whether the points at these distances lie in the prediction's grid."""
        origins, directions = self.scan.rays(places)
        return self.geometry.index(origins + directions * range_m.unsqueeze(-1))[1]

    def _clear(self, found: Hits, clear_m: Float[Tensor, " R"]) -> Bool[Tensor, " R"]:
        """Whether rays that are free up to these distances can judge the prediction: what lies beyond is not known."""
        return clear_m.isfinite() & ((found.labels == self.free_class) | (found.entry_m < clear_m))

    def _add(self, true_labels: Tensor, true_m: Tensor, labels: Tensor, error_m: Tensor, valid: Tensor) -> None:
        valid = valid & (true_labels != self.ignore_class)
        counts = count_rays(
            true_labels, true_m, labels, error_m, valid, self.num_classes, self.thresholds_m, self.range_edges_m
        )
        self.truth += counts.truth
        self.predicted += counts.predicted
        self.correct += counts.correct


def ray_iou(
    prediction: Shaped[Tensor, "B X Y Z"],
    target: Shaped[Tensor, "B Xt Yt Zt"],
    geometry: Cylinder | Cuboid,
    origins: Float[Tensor, "B O 3"] | None = None,
    observed: Bool[Tensor, "B Xt Yt Zt"] | None = None,
    num_classes: int = NUM_CLASSES,
    free_class: int = FREE,
    ignore_class: int = UNKNOWN,
    thresholds_m: Sequence[float | int] = (1.0, 2.0, 4.0),
    range_edges_m: Sequence[float | int] | None = None,
    directions: Float[Tensor, "D 3"] | None = None,
    target_geometry: Cylinder | Cuboid | None = None,
    hit: Literal["exit", "entry"] = "exit",
    count_free_rays: bool = False,
) -> dict[str, Tensor]:
    """RayIoU of these frames alone; see `RayIoU` for the definition, the arguments and the keys.

    Example:
        >>> grid = Cylinder((8, 16, 4), (0.0, 8.0), (-2.0, 2.0))
        >>> target = torch.zeros(1, 8, 16, 4, dtype=torch.uint8)
        >>> target[:, 4] = 4
        >>> level = torch.eye(3)[:2]
        >>> ray_iou(target.roll(1, dims=1), target, grid, directions=level, thresholds_m=(1.5,))["rayiou"].item()
        1.0
        >>> ray_iou(target.roll(1, dims=1), target, grid, directions=level, thresholds_m=(0.5,))["rayiou"].item()
        0.0
    """
    metric = RayIoU(
        geometry,
        num_classes,
        free_class,
        ignore_class,
        thresholds_m,
        range_edges_m,
        directions,
        target_geometry,
        hit,
        count_free_rays,
    )
    metric.update(prediction, target, origins, observed)
    return metric.compute()
