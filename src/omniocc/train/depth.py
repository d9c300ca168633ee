"""The depth stage: the cameras' images to a panorama of ranges, scored in metres and in sphere indices."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torchmetrics import CatMetric, MeanMetric

from omniocc.batch import Batch
from omniocc.data import Appearance, Disturbances
from omniocc.metric import CalibrationError, DepthMetrics
from omniocc.model.depth import DepthMap, Spheres
from omniocc.model.ops.depth.confidence import RIGHT_WITHIN
from omniocc.model.ops.padded import to_unit_range
from omniocc.model.protocols import Calibrates
from omniocc.train.adamw import AdamW
from omniocc.train.stage_task import StageTask, log_terms, step_generator

FARTHEST_M = 100.0
"""Largest range in errors in metres; ranges beyond are clamped."""
SAMPLES = 1000
"""Rays of a batch to which the confidence is fitted."""


class DepthTask(StageTask[nn.Module]):
    """Train an option of the depth slot, or only score one without weights; other arguments as in `StageTask`.

    Args:
        spheres: of the rig, for errors in indices; ranges nearer than all of them are not scored.
        range_edges_m: ends of the distance bands in which errors are given.
        seed: of the random choices of training, such as mirrored batches.
        appearance: changes of the training batches; None: as they are.
    """

    STAGE = "depth"

    def __init__(
        self,
        model: nn.Module,
        optimizer: AdamW,
        spheres: Spheres,
        range_edges_m: Sequence[float],
        seed: int,
        config: dict[str, Any],
        appearance: Appearance | Disturbances | None = None,
    ):
        super().__init__(model, optimizer, config)
        self.seed, self.appearance = seed, appearance
        self.errors = DepthMetrics(spheres.min_range_m, FARTHEST_M, spheres.count, range_edges_m)
        self.coverage, self.calibration, self.judged = MeanMetric(), CalibrationError(), CatMetric()
        self.last_judged = torch.empty(0, 3)

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Return the sum of the model's own loss terms; each is logged by name."""
        generator = step_generator(self, self.seed, batch_index)
        if self.appearance is not None:
            batch = self.appearance(batch, generator)
        images = to_unit_range(batch.images[:, -1])
        ranges = batch.erp_range_m, batch.camera_range_m
        terms = self.model.weighted_losses(images, batch.newest_rigs, *ranges, generator)  # type: ignore[operator]
        return log_terms(self, terms, batch)

    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Score a batch and return the predicted panoramas."""
        depth = self.model(batch.images[:, -1], batch.newest_rigs, batch.erp_range_m)
        if batch.erp_range_m is not None:
            self.errors.update(depth.range_m.float(), batch.erp_range_m)  # also of uncertain rays
            self.coverage.update(depth.valid[batch.erp_range_m.isfinite()].float())
            rows = score_confidence(depth, batch.erp_range_m)
            self.calibration.update(rows[:, 0], rows[:, 2] > 0)
            self.judged.update(rows[:: max(1, len(rows) // SAMPLES)])
        return depth.known_range_m()

    def log_scores(self, split: str) -> None:
        """Log `<split>/depth/...` and reset the scores."""
        scores = {**self.errors.compute(), **self.calibration.compute(), "coverage": self.coverage.compute()}
        self.log_dict({f"{split}/depth/{key}": value for key, value in scores.items()}, sync_dist=False)
        self.last_judged = torch.as_tensor(self.judged.compute()).reshape(-1, 3)
        for metric in (self.errors, self.calibration, self.coverage, self.judged):
            metric.reset()

    def fit_to_validation(self) -> None:
        """Fit the confidence of a network to the rays of the last validation."""
        if isinstance(self.model, Calibrates) and len(self.last_judged):
            confidence, range_m, right = self.last_judged.unbind(1)
            self.model.calibrate(confidence, range_m, right > 0)


def score_confidence(depth: DepthMap, true_range_m: Float[Tensor, "B h w"]) -> Float[Tensor, "N 3"]:
    """Return confidence, range and whether it is right (1 or 0) of every valid range with a known truth."""
    counted = depth.valid & ~true_range_m.isnan()
    range_m, true_m = depth.range_m[counted].float(), true_range_m[counted].float()
    right = (range_m - true_m).abs() <= RIGHT_WITHIN * true_m
    return torch.stack([depth.confidence[counted].float(), range_m, (right & true_m.isfinite()).float()], 1)
