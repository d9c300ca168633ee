"""Where a model loses its score: geometry or classes, itself, its sketch or its ranges; what cameras see of the car."""

from collections.abc import Sequence
from typing import cast

import torch
from jaxtyping import Bool, Float, Float32, UInt8
from torch import Tensor, nn
from torchmetrics import MeanMetric

from omniocc.batch import Batch
from omniocc.camera import Equirectangular, Rig
from omniocc.camera.parallax import pixels_per_metre
from omniocc.classes import FREE, UNKNOWN
from omniocc.data import Needs, OccupancyData, SourceSpec
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.model.occupancy import labels_of
from omniocc.model.ops.evidence import LOG_ODDS
from omniocc.model.protocols import LearnedSketch, Sketched, learns
from omniocc.progress import Progress
from omniocc.scores import Scores
from omniocc.train.occupancy import OccupancyTask
from rayiou.bands import as_edges, band_of, band_suffixes, num_rows

THRESHOLDS = (0.08, 0.15, 0.25, 0.35, 0.5)
"""Probabilities at which the sketch is cut, to compare its geometry with the model's."""


@torch.inference_mode()
def audit(task: OccupancyTask, data: OccupancyData) -> list[tuple[str, str]]:
    """Return what each part of a model costs, on validation scenes, in words.

    Raises:
        UserError: when there are none with true voxels.
    """
    data.restrict_to("val")
    data.prepare_data()
    scenes = data.source.scenes("val")
    if not scenes or data.voxels.read(scenes[0], 0) is None:
        raise UserError(f"{data.source.folder} has no true voxels of validation scenes, with which an audit compares")
    print(f"{len(scenes)} validation scenes of {data.source.folder}")
    needs = Needs(panorama=True)
    data.set_needs(needs, needs)
    data.setup()
    loader, task = data.in_order("val"), task.eval()
    found = Audit(task.model.geometry, data.spec, task.occupied_above)
    with Progress("audit", len(loader), "batches") as progress:
        for batch in loader:
            logits = task.predict(batch).logits
            images = batch.images[:, -1]
            found.update(logits, task.model.propose(images, batch.newest_rigs), batch)
            if batch.erp_range_m is not None and learns(type(task.model.sketch)):
                sketch = cast(LearnedSketch, task.model.sketch)
                seen = sketch.depth(images, batch.newest_rigs, batch.erp_range_m)
                found.update_ranges(seen.range_m, batch, sketch.panorama)
            progress.advance()
    return found.lines()


class Audit(nn.Module):
    """Score variants of a model's predictions, to see what each part of it costs.

    Args:
        geometry: grid of the predictions.
        spec: of the data: classes, bands and LiDAR rays of the scores.
        occupied_above: probability above which a cell is occupied; None: it has its most likely class.
    """

    def __init__(self, geometry: Grid, spec: SourceSpec, occupied_above: float | None = None):
        super().__init__()
        self.geometry, self.occupied_above = geometry, occupied_above
        self.model, self.true_geometry, self.true_classes = (Scores(geometry, spec) for _ in range(3))
        self.overlap = Overlap()
        self.sketch_overlaps = [Overlap() for _ in THRESHOLDS]
        self.range_errors = RangeErrors(spec.range_edges_m)
        self.confidence, self.accuracy, self.on_own_car = MeanMetric(), MeanMetric(), MeanMetric()

    def update(self, logits: Float[Tensor, "B K X Y Z"], sketched: Sketched, batch: Batch) -> None:
        """Add the predictions for a batch that has true voxels; `sketched` is that of the newest frames."""
        assert batch.voxels is not None
        truth, labels = batch.voxels, labels_of(logits, self.occupied_above)
        known = truth != UNKNOWN
        self.model.update(labels, batch)
        self.true_geometry.update(with_true_geometry(logits, truth), batch)
        self.true_classes.update(with_true_classes(labels, truth), batch)
        self.overlap.update(labels != FREE, truth)
        if sketched.bits is not None:
            probability = sketched.evidence()[:, LOG_ODDS].sigmoid()
            for cut, overlap in zip(THRESHOLDS, self.sketch_overlaps, strict=True):
                overlap.update(probability >= cut, truth)
        top = logits.float().softmax(1).amax(1)
        self.confidence.update(top[known])
        self.accuracy.update((labels == truth)[known].float())
        if batch.pixel_labels is not None:
            for rig, pixels in zip(batch.newest_rigs, batch.pixel_labels, strict=True):
                self.on_own_car.update(pairs_without_label(rig, self.geometry, pixels))

    def update_ranges(self, range_m: Float[Tensor, "B h w"], batch: Batch, panorama: Equirectangular) -> None:
        """Add the model's ranges for a batch that has true ones."""
        assert batch.erp_range_m is not None
        for one, true_m, rig in zip(range_m.cpu(), batch.erp_range_m.cpu(), batch.newest_rigs, strict=True):
            self.range_errors.update(one, true_m, panorama, rig)

    def lines(self) -> list[tuple[str, str]]:
        """Return what was measured and its value, in words."""
        rows = [("RayIoU of the model", self.model), ("RayIoU with true geometry", self.true_geometry)]
        rows += [("RayIoU with true classes", self.true_classes)]
        lines = [(name, f"{float(scores.compute()['rayiou']):.3f}") for name, scores in rows]
        overlaps = [("the model", self.overlap)]
        overlaps += [(f"the sketch at {cut}", one) for cut, one in zip(THRESHOLDS, self.sketch_overlaps, strict=True)]
        lines += [(f"voxel IoU (precision, recall) of {name}", one.text()) for name, one in overlaps if one.filled]
        lines += [("mean top probability, accuracy", f"{_mean(self.confidence):.3f}, {_mean(self.accuracy):.3f}")]
        if self.on_own_car.update_called:
            lines += [("(voxel, camera) pairs on pixels without a label", f"{_mean(self.on_own_car):.2%}")]
        return lines + self.range_errors.lines()


class RangeErrors:
    """Compare errors of range with what the rig can see: by how many pixels a wrong range moves a point's images.

    Args:
        edges_m: ends of the bands of true range.
    """

    def __init__(self, edges_m: Sequence[float]):
        self.edges_m = as_edges(edges_m)
        self.sums = torch.zeros(num_rows(self.edges_m), 5, dtype=torch.float64)

    def update(
        self, range_m: Float[Tensor, "h w"], true_m: Float[Tensor, "h w"], panorama: Equirectangular, rig: Rig
    ) -> None:
        """Add a panorama; directions without a true range do not count."""
        known: Bool[Tensor, "h w"] = true_m < self.edges_m[-1]
        true, error_m = true_m[known].double(), (range_m - true_m)[known].abs().double()
        px_per_m = pixels_per_metre(rig, panorama.rays()[known] * true[:, None])
        seen = px_per_m > 0
        measures = [torch.ones_like(true), error_m, seen, error_m * seen, error_m * px_per_m]
        self.sums.index_add_(0, band_of(true, self.edges_m), torch.stack([one.double() for one in measures], 1))

    def lines(self) -> list[tuple[str, str]]:
        """Return for each band the mean error in metres and in pixels of parallax, and how much two cameras see."""
        rows = zip(band_suffixes(self.edges_m), self.sums.tolist(), strict=False)
        return [
            (
                f"error of range, {suffix[1:]}",
                f"{error / count:.3f} m; seen by two cameras {seen / count:.0%}, "
                f"there {error_seen / max(1, seen):.3f} m or {pixels / max(1, seen):.2f} px",
            )
            for suffix, (count, error, seen, error_seen, pixels) in rows
            if count
        ]


class Overlap:
    """Count occupied voxels: found, missed, and wrong."""

    def __init__(self):
        self.counts = torch.zeros(3, dtype=torch.int64)

    @property
    def filled(self) -> bool:
        """Return whether anything was counted."""
        return bool(self.counts.any())

    def update(self, occupied: Tensor, truth: UInt8[Tensor, "B X Y Z"]) -> None:
        """Add predictions, which are ignored where the truth is unknown."""
        known, true = truth != UNKNOWN, truth != FREE
        parts = [occupied & true, ~occupied & true, occupied & ~true]
        self.counts += torch.stack([(part & known).sum() for part in parts]).cpu()

    def text(self) -> str:
        """Return IoU, precision and recall."""
        hit, missed, wrong = (float(count) for count in self.counts)
        return f"{hit / (hit + missed + wrong):.3f} ({hit / max(1, hit + wrong):.3f}, {hit / max(1, hit + missed):.3f})"


def with_true_geometry(logits: Float[Tensor, "B K X Y Z"], truth: UInt8[Tensor, "B X Y Z"]) -> UInt8[Tensor, "B X Y Z"]:
    """Return the likeliest class that is not free where the truth is occupied, free elsewhere."""
    best = logits[:, FREE + 1 :].argmax(1).to(torch.uint8) + (FREE + 1)
    return torch.where((truth != FREE) & (truth != UNKNOWN), best, FREE).to(torch.uint8)


def with_true_classes(labels: UInt8[Tensor, "B X Y Z"], truth: UInt8[Tensor, "B X Y Z"]) -> UInt8[Tensor, "B X Y Z"]:
    """Return the true class where prediction and truth are occupied, else the prediction."""
    both = (labels != FREE) & (truth != FREE) & (truth != UNKNOWN)
    return torch.where(both, truth, labels)


def pairs_without_label(rig: Rig, geometry: Grid, pixel_labels: UInt8[Tensor, "N H W"]) -> Float32[Tensor, " pairs"]:
    """Return 1 for every visible (voxel, camera) pair whose pixel has no class, such as the own car's, 0 for others.

    `pixel_labels` may have more cameras than the rig: a batch is padded to its largest rig.
    """
    centers = geometry.centers(torch.float64).reshape(-1, 3)
    pixels, valid = rig.project(centers)
    found: Sequence[Tensor] = [
        labels[place[seen][:, 1].round().long(), place[seen][:, 0].round().long()] == UNKNOWN
        for labels, place, seen in zip(pixel_labels[: len(rig.cameras)].cpu(), pixels, valid, strict=True)
    ]
    return torch.cat(list(found)).float()


def _mean(metric: MeanMetric) -> float:
    return float(metric.compute())
