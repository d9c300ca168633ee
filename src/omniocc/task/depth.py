"""The depth stage: six images to a panorama of ranges, judged in metres and in sphere indices."""

from typing import Any

from lightning.pytorch import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import Tensor, nn
from torchmetrics import MeanMetric

from omniocc.batch import Batch
from omniocc.metric import DepthMetrics
from omniocc.metric.bands import PAPER_RANGE_EDGES_M
from omniocc.model.depth import Spheres
from omniocc.model.occupancy import to_unit_range
from omniocc.task.adamw import AdamW
from omniocc.task.draws import step_generator
from omniocc.task.terms import log_terms

FARTHEST_M = 100.0
"""Ranges beyond count as that far when errors in metres are summed."""


class Depth(LightningModule):
    """Trains an option of the depth slot, or only judges one that has no weights.

    Args:
        model: option of the depth slot.
        optimizer: recipe for optimiser and schedule.
        spheres: of the rig, in whose indices errors are counted; what is nearer than all of them is not judged.
        seed: of the random choices of training, such as mirrored batches.
        config: the run's resolved configuration as plain data.
    """

    def __init__(self, model: nn.Module, optimizer: AdamW, spheres: Spheres, seed: int, config: dict[str, Any]):
        super().__init__()
        self.model = model
        self.optimizer = optimizer
        self.seed = seed
        self.config = config
        self.errors = DepthMetrics(spheres.min_range_m, FARTHEST_M, spheres.count, PAPER_RANGE_EDGES_M)
        self.coverage = MeanMetric()

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Sum of the model's own loss terms; each is logged by name."""
        images = to_unit_range(batch.images[:, -1])
        ranges = batch.erp_range_m, batch.camera_range_m
        generator = step_generator(self, self.seed, batch_index)
        terms = self.model.training_terms(images, batch.rigs, *ranges, generator)  # type: ignore[operator]
        return log_terms(self, terms, batch)

    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Judge a batch; returns the predicted panoramas."""
        return self._judge(batch)

    def test_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Judge a batch; returns the predicted panoramas."""
        return self._judge(batch)

    def _judge(self, batch: Batch) -> Tensor:
        assert batch.erp_range_m is not None
        depth = self.model(to_unit_range(batch.images[:, -1]), batch.rigs, batch.erp_range_m)
        # every ray counts, also those the model calls uncertain
        self.errors.update(depth.range_m.float(), batch.erp_range_m)
        self.coverage.update(depth.valid[batch.erp_range_m.isfinite()].float())
        return depth.known_range_m()

    def on_validation_epoch_end(self) -> None:
        """Log `val/depth/...`."""
        self._log("val")

    def on_test_epoch_end(self) -> None:
        """Log `test/depth/...`."""
        self._log("test")

    def _log(self, stage: str) -> None:
        scores = {**self.errors.compute(), "coverage": self.coverage.compute()}
        self.log_dict({f"{stage}/depth/{key}": value for key, value in scores.items()}, sync_dist=False)
        self.errors.reset()
        self.coverage.reset()

    def configure_optimizers(self) -> OptimizerLRSchedulerConfig:
        """As the recipe says, over all steps the trainer will take."""
        return self.optimizer.configure(self.model, int(self.trainer.estimated_stepping_batches))

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """The configuration travels with the weights."""
        checkpoint["config"] = self.config
