"""Steps of training and testing, counted by Lightning's hooks."""

import os
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.demos.boring_classes import BoringModel
from torch.utils.data import DataLoader

from omniocc.progress import STATUS_FILE, read_status
from omniocc.train import StepProgress, TrainingTime
from omniocc.train.callbacks import STOP, LastCheckpoint, StopAtSignal, validation_follows


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
    monkeypatch.setattr("omniocc.train.callbacks.time.monotonic", lambda: next(clock))
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


pytestmark = pytest.mark.filterwarnings("ignore")
SCORES = {2: 0.3, 4: 0.9, 6: 0.5, 8: 0.6}
"""Of the validation after each step: the second is the best."""


class Scored(BoringModel):
    """A model that notes at which steps it was validated."""

    def __init__(self) -> None:
        super().__init__()
        self.validated: list[int] = []

    def validation_step(self, batch, batch_idx):
        self.log("score", torch.tensor(SCORES[self.trainer.global_step]))
        self.validated.append(self.trainer.global_step)


class Killed(Callback):
    """Ends the training without a further checkpoint, when a hook is called at a step."""

    def __init__(self, hook: str, step: int):
        setattr(self, hook, lambda trainer, *_: self.end(trainer.global_step == step))

    def end(self, now: bool) -> None:
        if now:
            raise KeyboardInterrupt


def quiet_trainer(*callbacks: Callback, **options) -> Trainer:
    return Trainer(
        callbacks=list(callbacks),
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        accelerator="cpu",
        **{"limit_val_batches": 1, **options},
    )


def eight_steps(folder: Path, validate_every: int, *callbacks: Callback) -> Trainer:
    """Return a quiet trainer of eight steps, which validates one batch after every so many."""
    return quiet_trainer(
        *callbacks,
        max_steps=8,
        default_root_dir=str(folder),
        val_check_interval=validate_every,
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
    )


def fit(folder: Path, *callbacks: Callback) -> Scored:
    model, last = Scored(), folder / "last.ckpt"
    best = ModelCheckpoint(folder, "best", monitor="score", mode="max", enable_version_counter=False)
    trainer = eight_steps(folder, 2, best, LastCheckpoint(last, 1), *callbacks)
    try:
        trainer.fit(model, ckpt_path=str(last) if last.exists() else None)
    except (KeyboardInterrupt, SystemExit):
        assert trainer.global_step < 8
    return model


def best_step(folder: Path) -> int:
    return torch.load(folder / "best.ckpt", weights_only=False)["global_step"]


@pytest.mark.parametrize(
    ("hook", "step", "again"),
    [
        ("on_validation_batch_end", 4, [4, 6, 8]),  # before the best one was saved
        ("on_train_batch_start", 4, [6, 8]),  # after it
        ("on_train_batch_end", 3, [4, 6, 8]),
    ],
)
def test_no_validation_and_no_best_checkpoint_is_lost(tmp_path, hook, step, again):
    fit(tmp_path, Killed(hook, step))
    assert fit(tmp_path).validated == again
    assert best_step(tmp_path) == 4


def test_without_an_interruption_every_validation_is_done_once(tmp_path):
    assert fit(tmp_path).validated == [2, 4, 6, 8]
    assert best_step(tmp_path) == 4
    assert torch.load(tmp_path / "last.ckpt", weights_only=False)["global_step"] == 8


def test_the_newest_state_is_saved_every_so_many_steps(tmp_path):
    last = tmp_path / "last.ckpt"
    quiet_trainer(LastCheckpoint(last, 3), max_steps=7, limit_val_batches=0).fit(BoringModel())
    assert torch.load(last, weights_only=False)["global_step"] == 6


def test_what_a_training_goes_on_from_is_not_saved_again(tmp_path):
    last, other = tmp_path / "last.ckpt", tmp_path / "other.ckpt"
    quiet_trainer(LastCheckpoint(last, 3), max_steps=3, limit_val_batches=0).fit(BoringModel())
    on = quiet_trainer(LastCheckpoint(other, 3), Killed("on_train_batch_end", 5), max_steps=9, limit_val_batches=0)
    with pytest.raises(SystemExit):
        on.fit(BoringModel(), ckpt_path=str(last), weights_only=False)
    assert not other.exists()


def test_validations_outside_of_the_training_save_nothing(tmp_path):
    """One before its first step, to see whether it runs, and one alone."""
    last = tmp_path / "last.ckpt"
    trainer = quiet_trainer(LastCheckpoint(last, 1), Killed("on_train_start", 0), num_sanity_val_steps=1)
    with pytest.raises(SystemExit):
        trainer.fit(BoringModel())
    quiet_trainer(LastCheckpoint(last, 1)).validate(BoringModel(), verbose=False)
    assert not last.exists()


@pytest.mark.parametrize(
    ("every", "epoch", "batch", "follows"),
    [(1, 0, 9, True), (1, 0, 8, False), (2, 0, 9, False), (2, 1, 9, True), (2, 1, 10, False)],
)
def test_a_validation_follows_at_the_end_of_every_chosen_epoch(every, epoch, batch, follows):
    trainer = SimpleNamespace(
        val_check_batch=10, enable_validation=True, check_val_every_n_epoch=every, current_epoch=epoch
    )
    assert validation_follows(trainer, batch) is follows


@pytest.mark.parametrize(("total", "follows"), [(19, True), (20, False)])
def test_without_epochs_a_validation_follows_every_so_many_batches(total, follows):
    loop = SimpleNamespace(total_batch_idx=total)
    trainer = SimpleNamespace(val_check_batch=10, enable_validation=True, check_val_every_n_epoch=None, fit_loop=loop)
    assert validation_follows(trainer, 3) is follows


class SignalAt(Callback):
    def __init__(self, step: int, number: int = STOP):
        self.step, self.number = step, number

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == self.step:
            os.kill(os.getpid(), self.number)


def test_ctrl_c_saves_stops_and_goes_on_and_a_second_one_ends_at_once(tmp_path, capfd):
    before = signal.getsignal(signal.SIGINT)
    seen = SeenAtEnd()
    with pytest.raises(SystemExit) as ended:
        trainer_of(tmp_path, SignalAt(3, signal.SIGINT), seen).fit(BoringModel())
    signal.signal(signal.SIGINT, before)
    assert ended.value.code == 130
    assert capfd.readouterr().err.strip().splitlines() == [
        "Ctrl-C: a checkpoint is saved after this step; a second Ctrl-C ends at once",
        "stopped by Ctrl-C at step 4; the same command goes on",
    ]
    assert seen.handlers == {signal.SIG_DFL}, "the system ends the process"
    trainer = trainer_of(tmp_path)
    trainer.fit(BoringModel(), ckpt_path=str(tmp_path / "last.ckpt"))
    assert trainer.global_step == 8
    assert signal.getsignal(signal.SIGINT) == before


def test_after_another_error_ctrl_c_does_what_it_did(tmp_path):
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(SystemExit):
        trainer_of(tmp_path, SignalAt(3)).fit(BoringModel())
    assert signal.getsignal(signal.SIGINT) == before


def test_behind_nohup_ctrl_c_stays_ignored(tmp_path):
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    trainer = trainer_of(tmp_path, SignalAt(3, signal.SIGINT))
    try:
        trainer.fit(BoringModel())
    finally:
        signal.signal(signal.SIGINT, before)
    assert trainer.global_step == 8


class SeenAtEnd(Callback):
    def __init__(self):
        self.handlers = set()

    def on_exception(self, *_):
        self.handlers.add(signal.getsignal(signal.SIGINT))


class SignalInValidation(Callback):
    def on_validation_batch_start(self, *_):
        os.kill(os.getpid(), signal.SIGTERM)


def trainer_of(folder: Path, *callbacks: Callback) -> Trainer:
    stop = StopAtSignal(folder / "last.ckpt")
    return quiet_trainer(stop, *callbacks, max_steps=8, default_root_dir=str(folder), limit_val_batches=0)


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
        max_steps=8,
        default_root_dir=str(tmp_path),
        callbacks=[StopAtSignal(tmp_path / "last.ckpt"), SignalInValidation()],
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        limit_val_batches=2,
        limit_train_batches=3,
        num_sanity_val_steps=0,
        accelerator="cpu",
    )
    with pytest.raises(SystemExit) as ended:
        trainer.fit(BoringModel())
    assert "SIGTERM after step 3; the same command goes on" in str(ended.value.code)


@pytest.mark.parametrize("number", [STOP, signal.SIGTERM])
def test_a_stop_waits_for_the_validation_of_its_step(tmp_path, number):
    validated = []
    stop = StopAtSignal(tmp_path / "last.ckpt")
    trainer = eight_steps(tmp_path, 4, Validated(validated), SignalAt(3, number), stop)
    with pytest.raises(SystemExit, match="at step 4"):
        trainer.fit(BoringModel())
    assert validated == [4]


class Validated(Callback):
    def __init__(self, steps: list[int]):
        self.steps = steps

    def on_validation_end(self, trainer, *_):
        self.steps.append(trainer.global_step)
