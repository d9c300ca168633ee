"""RayIoU: occupancy scored by what LiDAR rays would hit first (SparseOcc, Liu et al. 2024), on any grid."""

import itertools
from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float, Shaped
from torch import Tensor
from torchmetrics import Metric

from omniocc.classes import CLASSES, FREE, NUM_CLASSES, UNKNOWN
from omniocc.geometry import Cuboid, Cylinder, Hits, ray_table
from omniocc.metric.checks import check_labels, check_same_batch
from omniocc.metric.directions import sparseocc_directions
from omniocc.metric.ray_counts import RayCounts, count_rays, ray_scores


class RayIoU(Metric):
    """RayIoU over a dataset, with the public protocol's counting.

    A ray counts if its true first hit is of a class other than free and unknown. It is correct at a threshold if the
    predicted first hit has the same class and lies at a distance that differs by less than the threshold. Counts are
    summed over rays, frames and processes; IoU = correct / (true + predicted - correct) for each class and threshold,
    and the mean runs over thresholds and over the classes present. A ray whose truth is free is dropped, so
    hallucinations on it go unpunished, as in the public protocol; a ray that never meets the grid is invalid (the
    public script takes voxel (0, 0, 0) for it).

    The paper does not say which thresholds, rays and origins it used. The default here is the mean over 1, 2 and 4 m of
    the public 39 x 360 rays from an ego LiDAR at the ego origin. Range bins go by the true distance along the ray.

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

    Raises:
        ValueError: if an argument makes no sense.
    """

    is_differentiable = False
    higher_is_better = True
    full_state_update = False
    truth: Tensor
    predicted: Tensor
    correct: Tensor
    directions: Tensor

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
    ):
        super().__init__()
        self.geometry, self.target_geometry = geometry, target_geometry or geometry
        self.num_classes, self.free_class, self.ignore_class = num_classes, free_class, ignore_class
        self.thresholds_m = _increasing("thresholds_m", thresholds_m, at_least=1)
        self.range_edges_m = () if range_edges_m is None else _increasing("range_edges_m", range_edges_m, at_least=2)
        self.hit = hit
        _check_classes(num_classes, free_class, ignore_class)
        rays = sparseocc_directions() if directions is None else directions
        self.register_buffer("directions", rays, persistent=False)
        bins, thresholds = max(len(self.range_edges_m), 1), len(self.thresholds_m)
        zeros = torch.zeros(bins, num_classes, dtype=torch.int64)
        self.add_state("truth", zeros, dist_reduce_fx="sum")
        self.add_state("predicted", zeros.clone(), dist_reduce_fx="sum")
        self.add_state("correct", zeros.unsqueeze(1).repeat(1, thresholds, 1), dist_reduce_fx="sum")

    def update(
        self,
        prediction: Shaped[Tensor, "B X Y Z"],
        target: Shaped[Tensor, "Bt Xt Yt Zt"],
        origins: Float[Tensor, "B O 3"] | None = None,
    ) -> None:
        """Adds predicted and true class ids of a batch.

        Args:
            prediction: class of every cell.
            target: true class of every cell, or `ignore_class`.
            origins: places in the ego frame (metres) that the rays start from; default the ego origin, for which
                the cells of all rays are found once and kept.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        prediction = self._check("prediction", prediction, self.geometry, None)
        target = self._check("target", target, self.target_geometry, self.ignore_class)
        check_same_batch("prediction", prediction, "target", target)
        for i in range(len(prediction)):
            places = self._origins(origins, i, prediction.device)
            found = self._cast(self.geometry, prediction[i], places)
            truth = self._cast(self.target_geometry, target[i], places)
            valid = truth.labels != self.free_class
            if self.target_geometry != self.geometry:
                valid &= self._inside(places, (truth.entry_m + truth.exit_m) / 2)
            true_m, predicted_m = (hits.entry_m if self.hit == "entry" else hits.exit_m for hits in (truth, found))
            self._add(truth.labels, true_m, found.labels, (true_m - predicted_m).abs(), valid)

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
        against voxels, where both sides share the bias.) A ray that hit nothing or a point outside the grid counts as
        free in truth, and is dropped.

        Args:
            prediction: class of every cell.
            range_m: true distance along each ray, inf where nothing is hit; the rays are `directions` from each
                origin in turn.
            labels: true class of what is hit; free where nothing is hit.
            origins: as in `update`.

        Raises:
            ValueError: naming a wrong shape, type or value.
        """
        prediction = self._check("prediction", prediction, self.geometry, None)
        rays = len(self.directions) * (1 if origins is None else origins.shape[1])
        labels = check_labels("labels", labels, (rays,), self.num_classes, self.ignore_class)
        check_same_batch("prediction", prediction, "labels", labels)
        if range_m.shape != labels.shape:
            raise ValueError(f"range_m must have shape {tuple(labels.shape)}, got {tuple(range_m.shape)}")
        for i in range(len(prediction)):
            places = self._origins(origins, i, prediction.device)
            found = self._cast(self.geometry, prediction[i], places)
            error_m = torch.maximum(found.entry_m - range_m[i], range_m[i] - found.exit_m).clamp(min=0)
            valid = (labels[i] != self.free_class) & self._inside(places, range_m[i])
            self._add(labels[i], range_m[i], found.labels, error_m, valid)
        # what torchmetrics does around `update`
        self._computed = None
        self._update_count += 1

    def compute(self) -> dict[str, Tensor]:
        """Scores over everything seen: see `omniocc.metric.ray_counts.ray_scores` for the keys."""
        counts = RayCounts(self.truth, self.predicted, self.correct)
        known = self.num_classes == NUM_CLASSES
        names = [CLASSES[c].name if known else str(c) for c in range(self.num_classes)]
        return ray_scores(counts, names, self.free_class, self.thresholds_m, self.range_edges_m)

    def _check(self, name: str, labels: Tensor, grid: Cylinder | Cuboid, ignore_class: int | None) -> Tensor:
        return check_labels(name, labels, grid.shape, self.num_classes, ignore_class)

    def _origins(self, origins: Tensor | None, sample: int, device: torch.device) -> Tensor:
        return torch.zeros(1, 3, device=device) if origins is None else origins[sample].to(device)

    def _rays(self, places: Float[Tensor, "O 3"]) -> tuple[Tensor, Tensor]:
        directions = self.directions.to(places.device)
        return places.repeat_interleave(len(directions), dim=0), directions.repeat(len(places), 1)

    def _cast(self, grid: Cylinder | Cuboid, labels: Tensor, places: Float[Tensor, "O 3"]) -> Hits:
        # uint8 wraps around, so the free class becomes 0 and no other one does
        shifted = labels - self.free_class
        rays = self._rays(places)
        hits = ray_table(grid, *rays).cast(shifted) if len(places) == 1 else grid.cast(shifted, *rays)
        return hits._replace(labels=hits.labels + self.free_class)

    def _inside(self, places: Float[Tensor, "O 3"], range_m: Float[Tensor, " R"]) -> Tensor:
        origins, directions = self._rays(places)
        points = origins + torch.nn.functional.normalize(directions, dim=-1) * range_m.unsqueeze(-1)
        return self.geometry.index(points)[1]

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
    num_classes: int = NUM_CLASSES,
    free_class: int = FREE,
    ignore_class: int = UNKNOWN,
    thresholds_m: Sequence[float | int] = (1.0, 2.0, 4.0),
    range_edges_m: Sequence[float | int] | None = None,
    directions: Float[Tensor, "D 3"] | None = None,
    target_geometry: Cylinder | Cuboid | None = None,
    hit: Literal["exit", "entry"] = "exit",
) -> dict[str, Tensor]:
    """RayIoU of these frames alone; see `RayIoU` for the definition, the arguments and the keys."""
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
    )
    metric.update(prediction, target, origins)
    return metric.compute()


def _increasing(name: str, values: Sequence[float | int], at_least: int) -> tuple[float, ...]:
    numbers = tuple(float(value) for value in values)
    rising = all(low < high for low, high in itertools.pairwise(numbers))
    if len(numbers) < at_least or not rising or numbers[0] < 0:
        raise ValueError(f"{name} must be {at_least} or more increasing distances in metres, got {numbers}")
    return numbers


def _check_classes(num_classes: int, free_class: int, ignore_class: int) -> None:
    if not 2 <= num_classes <= 255:
        raise ValueError(f"num_classes must be 2..255, got {num_classes}")
    if not 0 <= free_class < num_classes:
        raise ValueError(f"free_class must be 0..{num_classes - 1}, got {free_class}")
    if not num_classes <= ignore_class <= 255:
        raise ValueError(f"ignore_class must be {num_classes}..255, beyond the classes, got {ignore_class}")
