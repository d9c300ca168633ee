"""The sketch stage: panoramas of range to candidate voxels, scored by recall, precision and fraction."""

from collections.abc import Sequence
from typing import Any, cast

from torch import Tensor, nn

from omniocc.batch import Batch
from omniocc.geometry import Cuboid, Cylinder
from omniocc.loss import Rays, TotalLoss
from omniocc.metric import CandidateScores
from omniocc.model.protocols import LearnedSketch
from omniocc.train.adamw import AdamW
from omniocc.train.stage_task import StageTask, log_terms, step_generator


class SketchTask(StageTask[nn.Module]):
    """Train a learned sketch on panoramas of the depth stage; other arguments as in `StageTask`.

    Args:
        model: learned sketch; its depth option is not run, since batches hold the panoramas.
        range_edges_m: ends of the distance bands in which figures are given.
        seed: of the choice of rays.
        loss: of the occupancy stage, whose terms of measured rays train the sketch too; None: voxels alone.
    """

    STAGE = "sketch"

    def __init__(
        self,
        model: nn.Module,
        optimizer: AdamW,
        range_edges_m: Sequence[float],
        config: dict[str, Any],
        seed: int = 0,
        loss: TotalLoss | None = None,
    ):
        super().__init__(model, optimizer, config)
        self.seed = seed
        self.loss = loss if loss is not None and len(loss.lidar) else None
        grid = cast(Cylinder | Cuboid, self.sketch.geometry)
        self.raw = CandidateScores(grid, range_edges_m)
        self.dilated = CandidateScores(grid, range_edges_m)

    @property
    def sketch(self) -> LearnedSketch:
        """Return the model, typed as a learned sketch."""
        return cast(LearnedSketch, self.model)

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Return the sum of the loss terms; each is logged by name."""
        draw = step_generator(self, self.seed, batch_index)
        terms = {} if batch.voxels is None else self.sketch.weighted_losses(*panorama(batch), batch.voxels)
        if self.loss is not None:
            rays = rays_of(batch)
            logits = self.sketch.logits(*panorama(batch))
            terms |= self.loss.ray_terms(logits, rays and rays.without_classes(), draw)
        return log_terms(self, terms, batch)

    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Score a batch and return the predicted candidates."""
        logits = self.sketch.logits(*panorama(batch))
        candidates = self.sketch.candidates(logits)
        if batch.voxels is not None:
            self.raw.update(self.sketch.undilated_candidates(logits), batch.voxels)
            self.dilated.update(candidates, batch.voxels)
        return candidates

    def log_scores(self, split: str) -> None:
        """Log `<split>/sketch/...` and reset the scores."""
        for prefix, metric in ((f"{split}/sketch", self.dilated), (f"{split}/sketch/raw", self.raw)):
            self.log_dict({f"{prefix}/{key}": value for key, value in metric.compute().items()}, sync_dist=False)
            metric.reset()


def rays_of(batch: Batch) -> Rays | None:
    """Return the measured rays of a batch, if it has any."""
    if batch.scan_origins is None or batch.scan_ends is None or batch.scan_labels is None:
        return None
    return Rays(batch.scan_origins, batch.scan_ends, batch.scan_labels)


def panorama(batch: Batch) -> tuple[Tensor, Tensor]:
    """Return predicted ranges and the mask of valid ones, (B, h, w) each."""
    assert batch.depth_range_m is not None
    return finite_ranges(batch.depth_range_m)


def finite_ranges(range_m: Tensor) -> tuple[Tensor, Tensor]:
    """Return ranges with zeros where they are unknown, and the mask of known ones."""
    valid = range_m.isfinite()
    return range_m.masked_fill(~valid, 0.0), valid
