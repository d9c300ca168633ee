"""Stop a training before a time limit, without a lost step."""

import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint
from lightning.pytorch.utilities.exceptions import SIGTERMException

from omniocc.train.last import in_training, validation_follows

STOP = signal.SIGUSR2
"""Signal that comes some time before the limit: `hydra/launcher=slurm` asks for it."""


class StopAtSignal(Checkpoint):
    """After SIGUSR2 or SIGTERM save a checkpoint at the end of the step, in all processes at once, and end the script.

    A validation that follows the step is done first. It is a checkpoint callback, since Lightning calls these after all
    others, so that averages of weights have seen the step.

    The script ends with an error code: what started it must not take the training for finished.

    Args:
        path: file of the checkpoint from which the same command goes on.
    """

    def __init__(self, path: Path):
        self.path = path
        self._told = False
        self._earlier: Any = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._earlier = signal.signal(STOP, self._note)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        signal.signal(STOP, self._earlier)

    def on_train_batch_end(  # noqa: D102
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        stepped = (batch_idx + 1) % trainer.accumulate_grad_batches == 0
        if stepped and not validation_follows(trainer, batch_idx) and self._all_told(trainer):
            self._stop(trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        if in_training(trainer) and self._all_told(trainer):
            self._stop(trainer)

    def _stop(self, trainer: Trainer) -> None:
        trainer.save_checkpoint(self.path)
        name = "SIGUSR2" if self._told else "SIGTERM"
        first = trainer.is_global_zero
        sys.exit(f"stopped by {name} at step {trainer.global_step}; the same command goes on" if first else "")

    def on_exception(  # noqa: D102
        self, trainer: Trainer, pl_module: LightningModule, exception: BaseException
    ) -> None:
        if isinstance(exception, SIGTERMException):  # between steps, or in one process of several
            message = f"ended by SIGTERM after step {trainer.global_step}; the same command goes on from its checkpoint"
            exception.code = message if trainer.is_global_zero else ""

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._told = True

    def _all_told(self, trainer: Trainer) -> bool:
        """Return whether a signal has reached any process; outside of Slurm only one process is asked."""
        if trainer.world_size > 1 and "SLURM_JOB_ID" not in os.environ:
            return False
        return trainer.strategy.reduce_boolean_decision(self._told or trainer.received_sigterm, all=False)
