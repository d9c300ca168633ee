"""The newest checkpoint of a training, from which the same command goes on without a lost step or validation."""

from pathlib import Path
from typing import Any

from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint


def validation_follows(trainer: Trainer, batch_idx: int) -> bool:
    """Return whether a validation comes at the end of this training batch.

    A checkpoint written before that validation would lose it: Lightning counts it as done when it goes on from there.
    """
    every = trainer.val_check_batch  # None: by minutes
    if not trainer.enable_validation or every is None:
        return False
    if trainer.check_val_every_n_epoch is None:
        return (trainer.fit_loop.total_batch_idx + 1) % every == 0
    of_epoch = (trainer.current_epoch + 1) % trainer.check_val_every_n_epoch == 0
    return of_epoch and (batch_idx + 1) % every == 0


def in_training(trainer: Trainer) -> bool:
    """Return whether a validation is one on the way of a training."""
    return trainer.state.fn == "fit" and not trainer.sanity_checking


class LastCheckpoint(Checkpoint):
    """Save the newest state every few steps and after every validation.

    Lightning calls checkpoint callbacks after all others and in the order given: name the one of the best score before
    this one, so that its choice is saved too.

    Args:
        path: file of the checkpoint.
        every_n_steps: optimiser steps.
    """

    def __init__(self, path: Path, every_n_steps: int):
        self.path, self.every_n_steps = path, every_n_steps
        self._saved = 0

    def on_train_batch_end(  # noqa: D102
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        step = trainer.global_step
        if step % self.every_n_steps == 0 and step != self._saved and not validation_follows(trainer, batch_idx):
            self._save(trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        if in_training(trainer):
            self._save(trainer)

    def _save(self, trainer: Trainer) -> None:
        self._saved = trainer.global_step
        trainer.save_checkpoint(self.path)
