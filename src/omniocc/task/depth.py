"""The depth stage: the cameras' images to a panorama of ranges, scored in metres and in sphere indices."""

from collections.abc import Sequence
from typing import Any

from torch import Tensor, nn
from torchmetrics import MeanMetric

from omniocc.batch import Batch
from omniocc.data import Appearance
from omniocc.metric import DepthMetrics
from omniocc.model.depth import Spheres
from omniocc.model.occupancy import to_unit_range
from omniocc.task.adamw import AdamW
from omniocc.task.stage_task import StageTask, step_generator
from omniocc.task.terms import log_terms

FARTHEST_M = 100.0
"""Largest range in errors in metres; ranges beyond are clamped."""


class DepthTask(StageTask[nn.Module]):
    """Train an option of the depth slot, or only score one without weights; other arguments as in `StageTask`.

    Args:
        spheres: of the rig, for errors in indices; ranges nearer than all of them are not scored.
        range_edges_m: ends of the distance bands in which errors are given.
        seed: of the random choices of training, such as mirrored batches.
        appearance: changes of the training images; None: as they are.
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
        appearance: Appearance | None = None,
    ):
        super().__init__(model, optimizer, config)
        self.seed, self.appearance = seed, appearance
        self.errors = DepthMetrics(spheres.min_range_m, FARTHEST_M, spheres.count, range_edges_m)
        self.coverage = MeanMetric()

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Return the sum of the model's own loss terms; each is logged by name."""
        images = to_unit_range(batch.images[:, -1])
        ranges = batch.erp_range_m, batch.camera_range_m
        generator = step_generator(self, self.seed, batch_index)
        if self.appearance is not None:
            images = self.appearance(images, batch.image_mask()[:, -1], generator)
        terms = self.model.training_terms(images, batch.newest_rigs, *ranges, generator)  # type: ignore[operator]
        return log_terms(self, terms, batch)

    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Score a batch and return the predicted panoramas."""
        depth = self.model(to_unit_range(batch.images[:, -1]), batch.newest_rigs, batch.erp_range_m)
        if batch.erp_range_m is not None:
            # every ray is scored, also uncertain ones
            self.errors.update(depth.range_m.float(), batch.erp_range_m)
            self.coverage.update(depth.valid[batch.erp_range_m.isfinite()].float())
        return depth.known_range_m()

    def log_scores(self, split: str) -> None:
        """Log `<split>/depth/...` and reset the scores."""
        scores = {**self.errors.compute(), "coverage": self.coverage.compute()}
        self.log_dict({f"{split}/depth/{key}": value for key, value in scores.items()}, sync_dist=False)
        self.errors.reset()
        self.coverage.reset()
