"""Casting rays through predicted and true frames and counting what they hit; nothing is kept between calls."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from omniocc.classes import CLASSES, NUM_CLASSES
from omniocc.geometry import Cuboid, Cylinder, Hits, RayTable, Scan, ray_table
from omniocc.metric.checks import check_classes, check_increasing, check_labels, check_mask, check_same_batch
from omniocc.metric.directions import sparseocc_directions
from omniocc.metric.ray_counts import RayCounts, count_rays, ray_scores


class RayTruth(NamedTuple):
    """What real LiDAR rays saw: truth without a grid; see `RayIoU.update_rays`.

    Attributes:
        range_m: distance along each ray, inf where nothing is hit; the rays are the metric's directions from each
            origin in turn.
        labels: class of what is hit; free where nothing is hit.
    """

    range_m: Float[Tensor, "B R"]
    labels: Shaped[Tensor, "B R"]


class RayCounter:
    """The counting behind RayIoU, as a function of frames: it keeps nothing and talks to no other process.

    Arguments and errors are those of `omniocc.metric.RayIoU`, which adds up what this counts.
    """

    def __init__(
        self,
        geometry: Cylinder | Cuboid,
        num_classes: int,
        free_class: int,
        ignore_class: int,
        thresholds_m: Sequence[float | int],
        range_edges_m: Sequence[float | int] | None,
        directions: Float[Tensor, "D 3"] | None,
        target_geometry: Cylinder | Cuboid | None,
        hit: Literal["exit", "entry"],
        count_free_rays: bool,
    ):
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

    def zero(self) -> RayCounts:
        """Return the counts of no frames."""
        zeros = torch.zeros(max(len(self.range_edges_m), 1), self.num_classes, dtype=torch.int64)
        return RayCounts(zeros, zeros.clone(), zeros.unsqueeze(1).repeat(1, len(self.thresholds_m), 1))

    def count(
        self,
        prediction: Shaped[Tensor, "B *grid"],
        target: Shaped[Tensor, "Bt *target_grid"] | RayTruth,
        origins: Float[Tensor, "*places 3"] | None = None,
        observed: Shaped[Tensor, "Bo *observed_grid"] | None = None,
    ) -> RayCounts:
        """Return the summed counts of a batch; arguments as in `RayIoU.update`.

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
            samples = zip(prediction, target.range_m, target.labels, places, strict=True)
            found = [self._count_rays(*sample) for sample in samples]
        else:
            target = self._known(prediction, target, observed)
            found = [self._count_voxels(*sample) for sample in zip(prediction, target, places, strict=True)]
        zero = (part.to(prediction.device) for part in self.zero())
        return RayCounts(*(torch.stack(parts).sum(0) for parts in zip(zero, *found, strict=True)))

    def scores(self, counts: RayCounts) -> dict[str, Tensor]:
        """Return the scores of counts: see `omniocc.metric.ray_counts.ray_scores` for the keys."""
        known = self.num_classes == NUM_CLASSES
        names = [CLASSES[c].name if known else str(c) for c in range(self.num_classes)]
        return ray_scores(counts, names, self.free_class, self.thresholds_m, self.range_edges_m)

    def _known(self, prediction: Tensor, target: Tensor, observed: Tensor | None) -> Tensor:
        """Return the checked target, unknown where it is not observed."""
        target = check_labels("target", target, self.target_geometry.shape, self.num_classes, self.ignore_class)
        check_same_batch("prediction", prediction, "target", target)
        check_mask("observed", observed, target.shape)
        return target if observed is None else target.masked_fill(~observed, self.ignore_class)

    def _check_rays(self, prediction: Tensor, target: RayTruth, places: Tensor) -> None:
        rays = len(self.scan) * places.shape[1]
        check_labels("labels", target.labels, (rays,), self.num_classes, self.ignore_class)
        check_same_batch("prediction", prediction, "labels", target.labels)
        if target.range_m.shape != target.labels.shape:
            shapes = f"{tuple(target.labels.shape)}, got {tuple(target.range_m.shape)}"
            raise ValueError(f"range_m must have shape {shapes}")

    def _count_voxels(self, prediction: Tensor, target: Tensor, places: Float[Tensor, "O 3"]) -> RayCounts:
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
        return self._count(truth.labels, true_m, found.labels, (true_m - predicted_m).abs(), valid)

    def _count_rays(
        self, prediction: Tensor, range_m: Tensor, labels: Tensor, places: Float[Tensor, "O 3"]
    ) -> RayCounts:
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
        return self._count(labels, range_m, found.labels, error_m, valid)

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

    def _count(self, true_labels: Tensor, true_m: Tensor, labels: Tensor, error_m: Tensor, valid: Tensor) -> RayCounts:
        valid = valid & (true_labels != self.ignore_class)
        return count_rays(
            true_labels, true_m, labels, error_m, valid, self.num_classes, self.thresholds_m, self.range_edges_m
        )
