"""One line of progress with the time left: live in a terminal, now and then in a log file."""

import time
from typing import Any

from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import ProgressBar
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class StepProgress(ProgressBar):
    """Steps done of all steps, ETA, losses and the last validation; `seconds` between lines where no terminal is."""

    def __init__(self, stage: str, seconds: float = 30.0):
        super().__init__()
        self.stage = stage
        self.seconds = seconds
        self._console = Console()
        self._bar: Progress | None = None
        self._silent = False
        self._last_line_s = 0.0
        self._began_s = 0.0
        self._began_step = 0

    def disable(self) -> None:
        """Lightning asks for this in every process but the first."""
        self._silent = True

    def _start(self, title: str, total: int, done: int = 0) -> None:
        self._stop()
        self._title, self._total = title, total
        self._began_s = self._last_line_s = time.monotonic()
        self._began_step = done
        if self._console.is_terminal and not self._silent:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[text]}"),
            )
            self._bar = Progress(*columns, console=self._console)
            self._task = self._bar.add_task(title, total=total, completed=done, text="")
            self._bar.start()

    def _show(self, done: int, text: str) -> None:
        if self._bar is not None:
            self._bar.update(self._task, completed=done, text=text)
        if self._bar is not None or self._silent:
            return
        now_s = time.monotonic()
        if now_s - self._last_line_s >= self.seconds or done == self._total:
            self._last_line_s = now_s
            rate = (now_s - self._began_s) / max(1, done - self._began_step)
            left_s = round(rate * (self._total - done))
            print(
                f"{self._title} {done}/{self._total}, {rate:.2f} s each, left {left_s // 60}:{left_s % 60:02d}  {text}",
                flush=True,
            )

    def _stop(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._start(f"{self.stage} train", int(trainer.estimated_stepping_batches), trainer.global_step)

    def on_train_batch_end(self, trainer: Trainer, *args: Any) -> None:  # noqa: D102
        values = trainer.callback_metrics
        text = " ".join(f"{key}={float(values[key]):.3f}" for key in ("train/loss", "val/rayiou") if key in values)
        self._show(trainer.global_step, text)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._stop()

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._start(f"{self.stage} test", int(sum(trainer.num_test_batches)))

    def on_test_batch_end(  # noqa: D102
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        self._show(batch_idx + 1, "")

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:  # noqa: D102
        self._stop()

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:  # noqa: D102
        self._stop()
