"""The sketch stage: panoramas of range to candidate voxels, judged by recall, precision and share."""

from typing import Any, cast

from lightning.pytorch import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import Tensor

from omniocc.batch import Batch
from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import Candidates
from omniocc.metric.bands import PAPER_RANGE_EDGES_M
from omniocc.model.sketch import Omni
from omniocc.task.adamw import AdamW
from omniocc.task.terms import log_terms


class Sketch(LightningModule):
    """Trains the sketch network on panoramas that the depth stage has predicted.

    Args:
        model: sketch with a network; its depth part is not asked, the batch brings the panoramas.
        optimizer: recipe for optimiser and schedule.
        config: the run's resolved configuration as plain data.
    """

    def __init__(self, model: Omni, optimizer: AdamW, config: dict[str, Any]):
        super().__init__()
        self.model = model
        self.optimizer = optimizer
        self.config = config
        grid = cast(Cylinder | Cuboid, model.geometry)
        self.raw = Candidates(grid, PAPER_RANGE_EDGES_M)
        self.dilated = Candidates(grid, PAPER_RANGE_EDGES_M)

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Sum of the loss terms; each is logged by name."""
        return log_terms(self, self.model.training_terms(*panorama(batch), batch.voxels), batch)

    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Judge a batch; returns the candidates."""
        return self._judge(batch)

    def test_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Judge a batch; returns the candidates."""
        return self._judge(batch)

    def _judge(self, batch: Batch) -> Tensor:
        logits = self.model.logits(*panorama(batch))
        candidates = self.model.select(logits)
        self.raw.update(self.model.choose(logits), batch.voxels)
        self.dilated.update(candidates, batch.voxels)
        return candidates

    def on_validation_epoch_end(self) -> None:
        """Log `val/sketch/...`."""
        self._log("val")

    def on_test_epoch_end(self) -> None:
        """Log `test/sketch/...`."""
        self._log("test")

    def _log(self, stage: str) -> None:
        for prefix, metric in ((f"{stage}/sketch", self.dilated), (f"{stage}/sketch/raw", self.raw)):
            self.log_dict({f"{prefix}/{key}": value for key, value in metric.compute().items()}, sync_dist=False)
            metric.reset()

    def configure_optimizers(self) -> OptimizerLRSchedulerConfig:
        """As the recipe says, over all steps the trainer will take."""
        return self.optimizer.configure(self.model, int(self.trainer.estimated_stepping_batches))

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """The configuration travels with the weights."""
        checkpoint["config"] = self.config


def panorama(batch: Batch) -> tuple[Tensor, Tensor]:
    """Predicted ranges and where they are valid, (B, h, w) each."""
    assert batch.depth_range_m is not None
    return known(batch.depth_range_m)


def known(range_m: Tensor) -> tuple[Tensor, Tensor]:
    """Ranges with zeros for what is not known, and the mask of what is."""
    valid = range_m.isfinite()
    return range_m.masked_fill(~valid, 0.0), valid
