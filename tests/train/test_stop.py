"""A signal ends a training with a checkpoint, from which it goes on without a lost step."""

import os
import signal
from pathlib import Path

import pytest
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.demos.boring_classes import BoringModel

from omniocc.train.stop import STOP, StopAtSignal

pytestmark = pytest.mark.filterwarnings("ignore")


class SignalAt(Callback):
    def __init__(self, step: int, number: int = STOP):
        self.step, self.number = step, number

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == self.step:
            os.kill(os.getpid(), self.number)


class SignalInValidation(Callback):
    def on_validation_batch_start(self, *_):
        os.kill(os.getpid(), signal.SIGTERM)


def trainer_of(folder: Path, *callbacks: Callback) -> Trainer:
    return Trainer(
        max_steps=8, default_root_dir=str(folder), callbacks=[StopAtSignal(folder / "last.ckpt"), *callbacks],
        logger=False, enable_progress_bar=False, enable_model_summary=False,
        limit_val_batches=0, accelerator="cpu",
    )  # fmt: skip


@pytest.mark.parametrize(("number", "name"), [(STOP, "SIGUSR2"), (signal.SIGTERM, "SIGTERM")])
def test_training_saves_stops_and_goes_on(tmp_path, number, name):
    before = signal.getsignal(STOP)
    with pytest.raises(SystemExit, match=f"stopped by {name} at step 4; the same command goes on"):
        trainer_of(tmp_path, SignalAt(3, number)).fit(BoringModel())
    signal.signal(STOP, before)
    trainer = trainer_of(tmp_path)
    trainer.fit(BoringModel(), ckpt_path=str(tmp_path / "last.ckpt"))
    assert trainer.global_step == 8
    assert signal.getsignal(STOP) == before


def test_a_training_that_is_ended_between_steps_does_not_pass_for_finished(tmp_path):
    trainer = Trainer(
        max_steps=8, default_root_dir=str(tmp_path),
        callbacks=[StopAtSignal(tmp_path / "last.ckpt"), SignalInValidation()],
        logger=False, enable_progress_bar=False, enable_model_summary=False,
        limit_val_batches=2, limit_train_batches=3, num_sanity_val_steps=0, accelerator="cpu",
    )  # fmt: skip
    with pytest.raises(SystemExit) as ended:
        trainer.fit(BoringModel())
    assert ended.value.code == "ended by SIGTERM after step 3; the same command goes on from its checkpoint"


@pytest.mark.parametrize("number", [STOP, signal.SIGTERM])
def test_a_stop_waits_for_the_validation_of_its_step(tmp_path, number):
    validated = []
    trainer = Trainer(
        max_steps=8, default_root_dir=str(tmp_path),
        callbacks=[Validated(validated), SignalAt(3, number), StopAtSignal(tmp_path / "last.ckpt")],
        logger=False, enable_progress_bar=False, enable_model_summary=False,
        limit_val_batches=1, val_check_interval=4, check_val_every_n_epoch=None, num_sanity_val_steps=0,
        accelerator="cpu",
    )  # fmt: skip
    with pytest.raises(SystemExit, match="at step 4"):
        trainer.fit(BoringModel())
    assert validated == [4]


class Validated(Callback):
    def __init__(self, steps: list[int]):
        self.steps = steps

    def on_validation_end(self, trainer, *_):
        self.steps.append(trainer.global_step)
