"""Progress of training and testing."""

import time
from typing import Any

from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Callback, ProgressBar

from omniocc.progress import Progress


class TrainingTime(Callback):
    """Measure the time of training with its validations; a run that goes on after a stop adds to what it had."""

    def __init__(self) -> None:
        self._earlier_s = 0.0
        self._began_s: float | None = None

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
