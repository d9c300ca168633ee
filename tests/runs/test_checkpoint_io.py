"""Checkpoints survive every way in which saving can be cut off."""

import errno
import os
import resource
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from torch.utils.data import DataLoader, TensorDataset

from omniocc.errors import DataError, UserError
from omniocc.runs.checkpoint_io import LAST, previous_of, read_checkpoint, resumable
from omniocc.train.checkpoint_plugin import AtomicCheckpointIO

VALUES = 5000
FILE_BYTES = 4 * VALUES
"""Every checkpoint here is larger than this."""


def content(step: int) -> dict:
    return {"config": {"step": step}, "state_dict": {"model.weight": torch.full((VALUES,), float(step))}}


def step_of(path: Path) -> int:
    return read_checkpoint(path)["config"]["step"]


def saved(path: Path, *steps: int) -> AtomicCheckpointIO:
    plugin = AtomicCheckpointIO()
    for step in steps:
        plugin.save_checkpoint(content(step), path)
    return plugin


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def in_child(action: Callable[[], object]) -> int:
    """Exit code of a process that does this; the negative signal if one ended it."""
    child = os.fork()
    if child == 0:
        code = 70
        try:
            action()
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed_at(name: str, call: int) -> None:
    """Let this process be killed just before its given call of an `os` function, counted from one."""
    real, calls = getattr(os, name), iter(range(1, 100))

    def hooked(*args):
        if next(calls) == call:
            os.kill(os.getpid(), signal.SIGKILL)
        return real(*args)

    setattr(os, name, hooked)


def killed_inside_the_write() -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)  # Python ignores it and gets an error instead
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_BYTES // 2, FILE_BYTES // 2))


@pytest.mark.parametrize(
    ("prepare", "step"),
    [
        (killed_inside_the_write, 2),
        (lambda: killed_at("fsync", 1), 2),
        (lambda: killed_at("replace", 1), 2),
        (lambda: killed_at("replace", 2), 2),
        (lambda: killed_at("fsync", 2), 3),
    ],
    ids=["inside the write", "before the flush", "before both renames", "between them", "after them"],
)
def test_a_kill_at_any_stage_of_saving_costs_at_most_one_save(prepare, step, tmp_path):
    last = tmp_path / LAST
    plugin = saved(last, 1, 2)

    def save():
        prepare()
        plugin.save_checkpoint(content(3), last)

    assert in_child(save) in (-signal.SIGKILL, -signal.SIGXFSZ)
    found, mishap = resumable(last)
    assert found is not None
    assert step_of(found) == step
    assert (mishap is None) == (found == last)

    goes_on = AtomicCheckpointIO()
    goes_on.load_checkpoint(found)
    goes_on.save_checkpoint(content(4), last)
    assert step_of(last) == 4
    assert step_of(previous_of(last)) == step
    assert names(tmp_path) == sorted([LAST, previous_of(last).name]), "what the kill left is gone"


def test_a_limit_on_the_size_of_files_leaves_the_good_checkpoint(tmp_path):
    last = tmp_path / LAST
    plugin = saved(last, 1)

    def save():
        resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_BYTES // 2, FILE_BYTES // 2))
        with pytest.raises(DataError, match=rf"cannot write {last}: files may not grow .*ulimit -f"):
            plugin.save_checkpoint(content(2), last)

    assert in_child(save) == 0
    assert names(tmp_path) == [LAST]
    assert step_of(last) == 1


def test_nothing_is_copied_from_another_file_system(tmp_path, monkeypatch):
    elsewhere = Path("/dev/shm")
    if not os.access(elsewhere, os.W_OK) or elsewhere.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("there is no second file system to write to at /dev/shm")
    last = tmp_path / LAST
    plugin = saved(last, 1)

    def save():
        tempfile.tempdir = str(elsewhere)
        killed_at("sendfile", 1)  # by which Python copies files
        plugin.save_checkpoint(content(2), last)

    assert in_child(save) == 0
    assert step_of(last) == 2


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A file system with room for two checkpoints and a half."""
    size = f"size={5 * FILE_BYTES // 2 // 4096 * 4096 + 4096}"
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", tmp_path], capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip(f"only root may mount a small disk: {mounted.stderr.decode().strip()}")
    yield tmp_path
    subprocess.run(["umount", tmp_path], check=True)


def test_a_full_disk_is_told_with_what_is_missing(small_disk):
    last = small_disk / LAST
    plugin = saved(last, 1, 2)
    with pytest.raises(DataError) as error:
        plugin.save_checkpoint(content(3), last)
    needed_bytes, free_bytes = last.stat().st_size, os.statvfs(small_disk).f_bavail * os.statvfs(small_disk).f_frsize
    assert 0 < free_bytes < needed_bytes
    figures = f"({needed_bytes:,} bytes are needed, {free_bytes:,} are free)"
    assert f"{last}: the disk is full: free some space {figures}" in str(error.value)
    assert "\n" not in str(error.value)
    assert names(small_disk) == sorted([LAST, previous_of(last).name])
    assert [step_of(last), step_of(previous_of(last))] == [2, 1]


def test_an_error_while_flushing_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    best = tmp_path / "best.ckpt"
    plugin = saved(best, 1)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DataError, match=r"best\.ckpt: the disk is full: free some space \([\d,]+ bytes are needed"):
        plugin.save_checkpoint(content(2), best)
    assert names(tmp_path) == ["best.ckpt"]
    assert step_of(best) == 1


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: FILE_BYTES // 2])


def flip(path: Path) -> None:
    """Change one bit of the weights, which `torch.load` does not notice."""
    changed = bytearray(path.read_bytes())
    changed[changed.index(bytes(content(2)["state_dict"]["model.weight"].numpy())) + 2000] ^= 1
    path.write_bytes(changed)


@pytest.mark.parametrize("harm", [cut, flip, lambda path: path.write_bytes(b"")], ids=["cut", "bit", "empty"])
def test_a_damaged_checkpoint_costs_one_line_and_never_the_good_one_before(harm, tmp_path):
    last = tmp_path / LAST
    saved(last, 1, 2)
    assert resumable(last) == (last, None)
    harm(last)
    found, mishap = resumable(last)
    assert found == previous_of(last)
    assert mishap is not None
    assert f"{last} cannot be read (" in mishap
    assert "goes on from the one before, last.previous.ckpt" in mishap
    assert "\n" not in mishap

    goes_on = AtomicCheckpointIO()
    assert goes_on.load_checkpoint(found)["config"]["step"] == 1
    goes_on.save_checkpoint(content(3), last)
    assert [step_of(last), step_of(previous_of(last))] == [3, 1], "the damaged one took no good one's place"


def test_when_no_checkpoint_can_be_read_one_error_says_what_to_do(tmp_path):
    last = tmp_path / LAST
    assert resumable(last) == (None, None)
    saved(last, 1, 2)
    cut(last)
    cut(previous_of(last))
    with pytest.raises(
        UserError, match=r"neither .*last\.ckpt nor last\.previous\.ckpt can be read.*move .* elsewhere"
    ):
        resumable(last)
    previous_of(last).unlink()
    with pytest.raises(UserError, match=r"last\.ckpt is not a checkpoint .* damaged \(.*move .* elsewhere"):
        resumable(last)


class Line(LightningModule):
    """One weight that follows its batches."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.Linear(1, 1)

    def training_step(self, batch):
        loss = self.layer(batch[0]).square().mean()
        self.log("val/rayiou", self.global_step)
        return loss

    def configure_optimizers(self):
        return torch.optim.AdamW(self.parameters(), lr=0.1)

    def on_save_checkpoint(self, checkpoint):
        checkpoint["config"] = {"step": self.global_step}


def trained(folder: Path, steps: int, resume: Path | None = None) -> Line:
    torch.manual_seed(0)
    task = Line()
    trainer = Trainer(
        max_steps=steps,
        accelerator="cpu",
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        plugins=[AtomicCheckpointIO()],
        callbacks=[
            ModelCheckpoint(folder, "last", every_n_train_steps=1, enable_version_counter=False),
            ModelCheckpoint(
                folder, "best", monitor="val/rayiou", mode="max", every_n_train_steps=1, enable_version_counter=False
            ),
        ],
    )
    trainer.fit(task, DataLoader(TensorDataset(torch.ones(8, 1))), ckpt_path=resume and str(resume))
    trainer.save_checkpoint(folder / LAST)
    return task


def test_a_trainer_saves_and_resumes_through_it(tmp_path):
    whole = trained(tmp_path / "whole", 6)
    folder = tmp_path / "cut"
    trained(folder, 3)
    assert names(folder) == ["best.ckpt", "last.ckpt", "last.previous.ckpt"]
    cut(folder / LAST)
    found, _ = resumable(folder / LAST)
    resumed = trained(folder, 6, found)
    assert step_of(folder / LAST) == 6
    torch.testing.assert_close(resumed.state_dict(), whole.state_dict(), rtol=0, atol=0)
