"""One thread per test process: xdist already fills the cores, and sums keep one order."""

import os
from pathlib import Path

import pytest
import torch

os.environ.setdefault("OMP_NUM_THREADS", "1")
torch.set_num_threads(1)

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def data_root(tmp_path_factory) -> Path:
    """Rendered data shared by all test processes; the dataset's own lock keeps them apart."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base
    return shared / "data"
