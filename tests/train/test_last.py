"""A killed training goes on from its last checkpoint with every validation, and with the best one so far."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.demos.boring_classes import BoringModel

from omniocc.train.last import LastCheckpoint, validation_follows

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


def fit(folder: Path, *callbacks: Callback) -> Scored:
    model, last = Scored(), folder / "last.ckpt"
    best = ModelCheckpoint(folder, "best", monitor="score", mode="max", enable_version_counter=False)
    trainer = Trainer(
        max_steps=8, default_root_dir=str(folder), callbacks=[best, LastCheckpoint(last, 1), *callbacks], logger=False,
        enable_progress_bar=False, enable_model_summary=False, limit_val_batches=1, val_check_interval=2,
        check_val_every_n_epoch=None, num_sanity_val_steps=0, accelerator="cpu",
    )  # fmt: skip
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


def test_validations_outside_of_the_training_save_nothing(tmp_path):
    """One before its first step, to see whether it runs, and one alone."""
    last = tmp_path / "last.ckpt"
    trainer = quiet_trainer(LastCheckpoint(last, 1), Killed("on_train_start", 0), num_sanity_val_steps=1)
    with pytest.raises(SystemExit):
        trainer.fit(BoringModel())
    quiet_trainer(LastCheckpoint(last, 1)).validate(BoringModel(), verbose=False)
    assert not last.exists()


def quiet_trainer(*callbacks: Callback, **options) -> Trainer:
    return Trainer(
        callbacks=list(callbacks), logger=False, enable_progress_bar=False, enable_model_summary=False,
        accelerator="cpu", **{"limit_val_batches": 1, **options},
    )  # fmt: skip


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
