"""Callbacks of every training: progress, the newest checkpoint, and the end at a signal."""

import os
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Callback, Checkpoint, ProgressBar
from lightning.pytorch.utilities.exceptions import SIGTERMException

from omniocc.errors import INTERRUPTED
from omniocc.progress import Progress


class TrainingTime(Callback):
    """Measure the time of training with its validations; a run that goes on after a stop adds to what it had."""

    def __init__(self) -> None:
        self._earlier_s = 0.0
        self._began_s: float | None = None

    @property
    def began(self) -> bool:
        """Return whether training is under way: what it goes on from has been read."""
        return self._began_s is not None

    @property
    def minutes(self) -> float:
        """Return the time so far, rounded to a tenth of a minute."""
        return round(self._seconds() / 60, 1)

    def _seconds(self) -> float:
        return self._earlier_s + (0.0 if self._began_s is None else time.monotonic() - self._began_s)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._began_s = time.monotonic()

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._earlier_s, self._began_s = self._seconds(), None

    def state_dict(self) -> dict[str, Any]:  # noqa: D102
        return {"seconds": self._seconds()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:  # noqa: D102
        self._earlier_s = float(state_dict["seconds"])


class StepProgress(ProgressBar):
    """Show finished and total steps, the time left, the loss and the last validation score."""

    def __init__(self, stage: str):
        super().__init__()
        self.stage = stage
        self._silent = False
        self._progress: Progress | None = None

    def disable(self) -> None:
        """Show nothing; Lightning calls this in every process but the first."""
        self._silent = True

    def _start(self, title: str, total: int, done: int = 0) -> None:
        if not self._silent:
            self._progress = Progress(f"{self.stage} {title}", total, "steps", done).__enter__()

    def _show(self, done: int, text: str = "") -> None:
        if self._progress is not None:
            self._progress.advance(done - self._progress.done, text)

    def _stop(self, error: BaseException | None = None) -> None:
        if self._progress is not None:
            self._progress.__exit__(error and type(error), error, None)
            self._progress = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._start("train", int(trainer.estimated_stepping_batches), trainer.global_step)

    def on_train_batch_end(self, trainer: Trainer, *args: Any) -> None:  # noqa: D102
        values = trainer.callback_metrics
        text = " ".join(f"{key}={float(values[key]):.3f}" for key in ("train/loss", "val/rayiou") if key in values)
        self._show(trainer.global_step, text)

    def on_validation_batch_end(  # noqa: D102
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int, *_: Any
    ) -> None:
        if in_training(trainer):
            self._show(trainer.global_step, f"validation {batch_idx + 1}/{int(sum(trainer.num_val_batches))}")

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._stop()

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._start("test", int(sum(trainer.num_test_batches)))

    def on_test_batch_end(  # noqa: D102
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int, *_: Any
    ) -> None:
        self._show(batch_idx + 1)

    on_test_end = on_train_end

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:  # noqa: D102
        self._stop(exception)


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

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._saved = trainer.global_step  # what a training goes on from is not saved again

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


STOP = signal.SIGUSR2
"""Signal that comes some time before the limit: `hydra/launcher=slurm` asks for it."""
CTRL_C = "Ctrl-C"
ERRORS = 2
"""File descriptor of what is printed about errors."""


class StopAtSignal(Checkpoint):
    """After SIGUSR2, SIGTERM or Ctrl-C save a checkpoint at the end of the step, and end the script.

    Several processes do so together, and only in a job of Slurm. A second Ctrl-C ends the process at once; so does the
    first where several train.

    A validation that follows the step is done first. It is a checkpoint callback, since Lightning calls these after all
    others, so that averages of weights have seen the step.

    The script ends with an error code: what started it must not take the training for finished.

    Args:
        path: file of the checkpoint from which the training can go on.
        again: what goes on from it, in words.
    """

    def __init__(self, path: Path, again: str = "the same command goes on"):
        self.path, self.again = path, again
        self._told: str | None = None
        self._earlier: dict[int, Any] = {}

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        # behind nohup or & Ctrl-C is ignored, and it stays so
        alone = trainer.world_size == 1 and signal.getsignal(signal.SIGINT) != signal.SIG_IGN
        heard = (STOP, signal.SIGINT) if alone else (STOP,)
        self._earlier = {number: signal.signal(number, self._note) for number in heard}

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        for number, handler in self._earlier.items():
            signal.signal(number, handler)

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
        name = self._told or "SIGTERM"
        line = f"stopped by {name} at step {trainer.global_step}; {self.again}"
        if name == CTRL_C:
            print(line, file=sys.stderr, flush=True)
            sys.exit(INTERRUPTED)
        sys.exit(line if trainer.is_global_zero else "")

    def on_exception(  # noqa: D102
        self, trainer: Trainer, pl_module: LightningModule, exception: BaseException
    ) -> None:
        if isinstance(exception, SIGTERMException):  # between steps, or in one process of several
            message = f"ended by SIGTERM after step {trainer.global_step}; {self.again} from its checkpoint"
            exception.code = message if trainer.is_global_zero else ""
        if self._told != CTRL_C and signal.SIGINT in self._earlier:
            signal.signal(signal.SIGINT, self._earlier[signal.SIGINT])

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._told = CTRL_C if number == signal.SIGINT else "SIGUSR2"
        if self._told == CTRL_C:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            # not by `print`, which may be interrupted in the middle of a line and must not be called again then
            os.write(ERRORS, b"\nCtrl-C: a checkpoint is saved after this step; a second Ctrl-C ends at once\n")

    def _all_told(self, trainer: Trainer) -> bool:
        """Return whether a signal has reached any process; False where several train outside of Slurm."""
        if trainer.world_size > 1 and "SLURM_JOB_ID" not in os.environ:
            return False
        return trainer.strategy.reduce_boolean_decision(bool(self._told) or trainer.received_sigterm, all=False)
