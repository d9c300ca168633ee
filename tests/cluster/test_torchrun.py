"""Training on two machines by torchrun: two agents on this one, each with one process."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from slurm import free_port

from omniocc.runs.results import METRICS

pytestmark = pytest.mark.cluster
ROOT = Path(__file__).parents[2]


def agents(folder: Path, *overrides: str) -> list[tuple[int, str]]:
    """Return exit code and output of two agents of one run."""
    place = f"127.0.0.1:{free_port()}"
    torchrun = [
        sys.executable,
        "-m",
        "torch.distributed.run",
        "--nnodes=2",
        "--nproc-per-node=1",
        "--rdzv-backend=c10d",
    ]
    training = [
        str(ROOT / "src" / "train.py"),
        "preset=smoke",
        "logger.mode=disabled",
        "test_images=0",
        "trainer.num_nodes=2",
        "trainer.devices=1",
        "trainer.strategy=ddp",
        "trainer.accelerator=cpu",
        "data.batch_size=1",
        *overrides,
    ]
    started = [
        subprocess.Popen(
            [*torchrun, f"--rdzv-endpoint={place}", *training],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for _ in range(2)
    ]
    said = [process.communicate(timeout=400)[0] for process in started]
    return [(process.returncode, text) for process, text in zip(started, said, strict=True)]


def test_two_machines_train_one_model(tmp_path):
    found = agents(tmp_path, "model=extended", "preset.stages.occupancy.max_steps=2")
    assert [code for code, _ in found] == [0, 0], found
    (path,) = tmp_path.glob(f"runs/train-*/{METRICS}")
    assert json.loads(path.read_text())["steps"] == 2
    assert sum("figures   runs/train" in text for _, text in found) == 1  # one of them writes and prints
    again = agents(tmp_path, "model=extended", "preset.stages.occupancy.max_steps=2", "resume=never")
    assert all(code for code, _ in again)
    assert any("cannot agree on a new folder" in text for _, text in again)
