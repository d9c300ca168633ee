"""Steps of training and testing, counted by Lightning's hooks."""

import pytest
import torch
from lightning.pytorch import LightningModule, Trainer
from torch.utils.data import DataLoader

from omniocc.progress import STATUS_FILE, read_status
from omniocc.train import StepProgress, TrainingTime


class Line(LightningModule):
    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(()))

    def training_step(self, batch, index):
        loss = (self.weight - batch.mean()) ** 2
        self.log("train/loss", loss)
        return loss

    def test_step(self, batch, index):
        pass

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), 0.1)


@pytest.fixture
def trainer(tmp_path, monkeypatch):
    monkeypatch.setenv(STATUS_FILE, str(tmp_path / "status.json"))
    return Trainer(
        callbacks=[StepProgress("depth")],
        max_steps=6,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        accumulate_grad_batches=2,
    )


def test_steps_of_training_and_testing_are_counted(trainer, tmp_path, capsys):
    batches = DataLoader(torch.ones(24, 1), batch_size=2)
    trainer.fit(Line(), batches)
    status = read_status(tmp_path / "status.json")
    assert (status.title, status.done, status.total, status.unit) == ("depth train", 6, 6, "steps")
    assert status.text.startswith("train/loss=")
    assert "depth train: 6/6 steps" in capsys.readouterr().err
    trainer.test(Line(), batches, verbose=False)
    status = read_status(tmp_path / "status.json")
    assert (status.title, status.done, status.total) == ("depth test", 12, 12)


def test_other_processes_than_the_first_are_silent(trainer, tmp_path, capsys):
    trainer.callbacks[0].disable()
    trainer.test(Line(), DataLoader(torch.ones(4, 1)), verbose=False)
    assert not (tmp_path / "status.json").exists()
    assert "depth test" not in capsys.readouterr().err


def test_the_time_of_training_goes_on_after_a_stop(tmp_path, monkeypatch):
    clock = iter(range(0, 10_000, 30))
    monkeypatch.setattr("omniocc.train.progress.time.monotonic", lambda: next(clock))
    first, second = TrainingTime(), TrainingTime()
    assert first.minutes == 0
    first.on_train_start(None, None)
    state = first.state_dict()
    assert state == {"seconds": 30.0}
    second.load_state_dict(state)
    second.on_train_start(None, None)
    second.on_train_end(None, None)
    assert second.minutes == second.minutes == 1.0


def test_lightning_keeps_the_time_in_checkpoints(tmp_path):
    options = {"accelerator": "cpu", "logger": False, "enable_checkpointing": False, "enable_model_summary": False}
    batches, first, second = DataLoader(torch.ones(8, 1)), TrainingTime(), TrainingTime()
    trainer = Trainer(callbacks=[first], max_epochs=1, enable_progress_bar=False, **options)
    trainer.fit(Line(), batches)
    first._earlier_s += 600
    trainer.save_checkpoint(tmp_path / "x.ckpt")
    Trainer(callbacks=[second], max_epochs=2, enable_progress_bar=False, **options).fit(
        Line(), batches, ckpt_path=tmp_path / "x.ckpt"
    )
    assert 10 <= second.minutes < 11
