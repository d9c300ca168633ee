"""A signal ends a training with a checkpoint, from which it goes on without a lost step."""

import os
import signal
from pathlib import Path

import pytest
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.demos.boring_classes import BoringModel

from omniocc.task.stop import STOP, StopAtSignal

pytestmark = pytest.mark.filterwarnings("ignore")


class SignalAt(Callback):
    def __init__(self, step: int):
        self.step = step

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == self.step:
            os.kill(os.getpid(), STOP)


def trainer_of(folder: Path, *callbacks: Callback) -> Trainer:
    return Trainer(
        max_steps=8, default_root_dir=str(folder), callbacks=[StopAtSignal(folder / "last.ckpt"), *callbacks],
        logger=False, enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
        limit_val_batches=0, accelerator="cpu",
    )  # fmt: skip


def test_training_saves_stops_and_goes_on(tmp_path):
    before = signal.getsignal(STOP)
    with pytest.raises(SystemExit, match="stopped by SIGUSR2 at step 4; the same command goes on"):
        trainer_of(tmp_path, SignalAt(3)).fit(BoringModel())
    signal.signal(STOP, before)
    trainer = trainer_of(tmp_path)
    trainer.fit(BoringModel(), ckpt_path=str(tmp_path / "last.ckpt"))
    assert trainer.global_step == 8
    assert signal.getsignal(STOP) == before
