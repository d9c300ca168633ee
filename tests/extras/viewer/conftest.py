"""Models with random weights, at the size of `preset=smoke`, and scenes that they are tested on."""

from pathlib import Path

import pytest
from made_scenes import SCENES, write_checkpoint, write_scene


@pytest.fixture(scope="session")
def dataset(tmp_path_factory, spec) -> Path:
    """Return a folder with two recorded test scenes."""
    root = tmp_path_factory.mktemp("viewer-data")
    for number, name in enumerate(SCENES):
        write_scene(root / name, spec, 10 * number)
    return root


@pytest.fixture(scope="session")
def make_run(tmp_path_factory, smoke, spec, dataset):
    """Return a function that makes the folder of a run whose model has random weights and predicts many classes."""

    def make(name: str, *overrides: str, seed: int = 3) -> Path:
        splits = "data.source.splits={train: [test-*], val: [], test: []}"
        cfg = smoke("data=recorded", f"data.source.root={dataset}", splits, *overrides)
        cfg.data.source.splits = {"train": [SCENES[0]], "val": [], "test": list(SCENES[1:])}
        return write_checkpoint(tmp_path_factory.mktemp("runs") / name / "best.ckpt", cfg, spec, seed).parent

    return make


@pytest.fixture(scope="session")
def cylinder_run(make_run) -> Path:
    return make_run("ours-0a1b2c3d")


@pytest.fixture(scope="session")
def cuboid_run(make_run) -> Path:
    return make_run("cuboid-4e5f6a7b", "model/geometry=cuboid", seed=4)
