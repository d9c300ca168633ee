import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from omniocc.data.loader import Loader
from omniocc.errors import DataError

SIZE = 50_000
SMALL = 'mount -t tmpfs -o size=150k tmpfs /dev/shm && exec "$0" "$@"'
"""Commands of a process that alone sees a small /dev/shm."""


class Numbers(Dataset):
    def __len__(self):
        return 8

    def __getitem__(self, index):
        return torch.full((SIZE,), index, dtype=torch.uint8)


class Unsendable:
    """It can be pickled by the thread that makes it, not by the one that sends it."""

    def __reduce__(self):
        if threading.current_thread() is threading.main_thread():
            return Unsendable, ()
        raise OSError("no socket")


def unsendable(_samples):
    return Unsendable()


def read() -> list[int]:
    """Read all numbers by two processes."""
    return [int(number) for batch in Loader(Numbers(), 2, 2, torch.stack) for number in batch[:, -1]]


def test_batches_are_those_of_this_process():
    assert read() == list(range(8))


def in_small_memory(code: str) -> subprocess.CompletedProcess:
    command = ["unshare", "--mount", "sh", "-c", SMALL, sys.executable]
    probe = subprocess.run([*command, "-c", ""], capture_output=True, text=True, check=False)
    if probe.returncode:
        pytest.skip(f"only root may mount a small /dev/shm: {probe.stderr.strip()}")
    path = os.pathsep.join(sys.path)
    run = subprocess.run(
        [*command, "-c", code], capture_output=True, text=True, timeout=150, env=os.environ | {"PYTHONPATH": path}
    )
    assert run.returncode == 0, run.stderr
    return run


@pytest.mark.whole_runs
def test_batches_that_find_no_shared_memory_come_through_pipes_and_it_is_told_once():
    run = in_small_memory(f"import {Path(__file__).stem} as test; print(test.read())")
    told, numbers = run.stdout.splitlines()
    assert told.startswith("data.num_workers=2: /dev/shm has no room for the batches")
    assert "--shm-size" in told
    assert "data.num_workers=0" in told
    assert numbers == str(list(range(8)))


@pytest.mark.whole_runs
def test_a_process_that_cannot_send_ends_the_training_with_a_line():
    with pytest.raises(DataError, match=r"^data.num_workers=1: a loader process ended.*same command again"):
        next(iter(Loader(Numbers(), 2, 1, unsendable)))


def test_processes_that_cannot_start_are_a_line(monkeypatch):
    def start(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(DataLoader, "__iter__", start)
    batches = iter(Loader(Numbers(), 2, 2, torch.stack))
    with pytest.raises(DataError, match=r"^data.num_workers=2: .*/dev/shm is full \(No space.*--shm-size"):
        next(batches)
