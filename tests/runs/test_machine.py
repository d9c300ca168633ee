"""The machine of a run."""

from pathlib import Path

import torch

from omniocc.runs.machine import memory_bytes


def test_the_memory_of_this_machine_is_what_linux_says():
    stated = next(line for line in Path("/proc/meminfo").read_text("utf-8").splitlines() if line.startswith("MemTotal"))
    assert memory_bytes(torch.device("cpu")) == int(stated.split()[1]) * 1024
