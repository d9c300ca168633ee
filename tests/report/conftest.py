"""A sweep made once for all tests of reports."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from fake_sweep import write_sweep


@pytest.fixture(scope="session")
def runs(tmp_path_factory) -> Path:
    """Folder of finished runs, the dataset beside it; read only."""
    return write_sweep(tmp_path_factory.mktemp("sweep"))
