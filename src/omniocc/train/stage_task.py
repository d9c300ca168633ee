"""Base of the tasks of all stages: steps that score, optimiser, random draws, and content of checkpoints."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import torch
from lightning.pytorch import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRSchedulerConfig
from torch import Tensor, nn

from omniocc.batch import Batch
from omniocc.bounds import Limit, Number
from omniocc.errors import UserError
from omniocc.runs.checkpoint import CONFIG, STAGE
from omniocc.train.adamw import AdamW

Model = TypeVar("Model", bound=nn.Module)


@dataclass(frozen=True)
class Recipe:
    """Describe the training of one stage.

    Attributes:
        max_steps: optimiser steps; -1: as many as `max_epochs` are.
        max_epochs: passes over the training frames; None: as many as `max_steps` are.
        batch_size: samples per process and step.
        validate_every_n_epochs: passes over the training frames from one validation to the next; None: 1, or up to five
            times at equal distances if steps end the training.
        seed: of weights and order of samples.
        optimizer: settings of AdamW.
        weights: checkpoint, or name of shipped weights, from which the stage starts; None: from random ones. With
            `max_steps` 0 depth and sketch use it as it is.
    """

    max_steps: Limit
    max_epochs: Limit | None
    batch_size: Number
    validate_every_n_epochs: Number | None
    seed: int
    optimizer: AdamW
    weights: str | None = None


class StageTask(LightningModule, Generic[Model]):
    """The model of one stage, its optimiser and its configuration.

    Args:
        config: the run's resolved configuration as plain data; with it the checkpoint suffices to rebuild the model.

    Attributes:
        lr_multipliers: of the learning rate, by parts of the model.
    """

    STAGE: ClassVar[str]
    lr_multipliers: Mapping[str, float] = MappingProxyType({})

    def __init__(self, model: Model, optimizer: AdamW, config: dict[str, Any]):
        super().__init__()
        self.model = model
        self.optimizer = optimizer
        self.config = config

    @abstractmethod
    def log_scores(self, split: str) -> None:
        """Log all scores under `<split>/...` and reset them."""

    @abstractmethod
    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Score a batch and return the prediction."""

    def test_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Score a batch and return the prediction."""
        return self.validation_step(batch, batch_index)

    def fit_to_validation(self) -> None:
        """Fit to the last validation what is not trained; called once, at the end of the training."""

    def on_validation_epoch_end(self) -> None:
        """Log the scores of the validation."""
        self.log_scores("val")

    def on_test_epoch_end(self) -> None:
        """Log the scores of the test."""
        self.log_scores("test")

    def configure_optimizers(self) -> OptimizerLRSchedulerConfig:
        """Return optimiser and schedule over all steps that the trainer will take."""
        return self.optimizer.configure(self.model, int(self.trainer.estimated_stepping_batches), self.lr_multipliers)

    def on_before_optimizer_step(self, optimizer: torch.optim.Optimizer) -> None:
        """Log the learning rate of the parts of the model that have no factor."""
        self.log("train/learning_rate", optimizer.param_groups[0]["lr"])

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add stage and configuration to the weights."""
        checkpoint |= {STAGE: self.STAGE, CONFIG: self.config}


def step_generator(task: LightningModule, seed: int, batch_index: int) -> torch.Generator:
    """Return a CPU generator that depends only on seed, optimiser step, batch index in the epoch, and process."""
    key = [seed, task.global_step, batch_index, task.global_rank]
    return torch.Generator().manual_seed(int(np.random.SeedSequence(key).generate_state(1)[0]))


def log_terms(task: LightningModule, terms: Mapping[str, Tensor], batch: Batch) -> Tensor:
    """Return the sum of the terms, after logging `train/loss/<name>` and `train/loss`.

    Raises:
        UserError: naming the frames, when there are no terms or their sum is not finite.
    """
    if not terms:
        raise UserError(f"nothing to learn from: no loss applies to the labels of {', '.join(batch.frame_ids)}")
    total = torch.stack(list(terms.values())).sum()
    size = len(batch.frame_ids)
    task.log_dict({f"train/loss/{name}": term.detach() for name, term in terms.items()}, batch_size=size)
    task.log("train/loss", total.detach(), batch_size=size)
    if not torch.isfinite(total):
        values = ", ".join(f"{name}={float(term.detach()):.3g}" for name, term in terms.items())
        raise UserError(
            f"the loss is not finite at step {task.global_step} ({values}); frames: {', '.join(batch.frame_ids)}"
        )
    return total
