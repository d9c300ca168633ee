"""A short scene of the virtual world, and its export as a log in folders: the reference of every import."""

import sys
from pathlib import Path

import pytest

from omniocc.config import build
from omniocc.data import SceneReader

sys.path.insert(0, str(Path(__file__).parent))  # log_files

from log_files import built, write_log


@pytest.fixture(scope="session")
def original(composed, data_root) -> SceneReader:
    """Return a rendered scene; tests of other folders use the same."""
    world = build(composed("preset=smoke").data.source)
    world.root = str(data_root)
    world.prepare(world.plans[:1])
    return world.reader(world.plans[0])


@pytest.fixture(scope="session")
def log_folder(original, tmp_path_factory) -> Path:
    """Return the scene as a log: PNG images, `poses.csv`, `rig.yaml`, clouds in four formats."""
    return write_log(original, tmp_path_factory.mktemp("log"))


@pytest.fixture
def recorder(log_folder):
    """Return a function that builds the recorder of the folder with other options."""

    def make(*overrides: str, log: Path = log_folder, name: str = "train-000-own"):
        return built("files", f"name={name}", f"log={log}", *overrides)

    return make
