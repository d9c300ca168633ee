"""One thread per test process: xdist already fills the cores, and sums keep one order."""

import copy
import functools
import os
import resource
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig
from torch import Tensor, nn

from omniocc.data import SourceSpec
from omniocc.model import OccupancyModel
from omniocc.parts import Parts
from omniocc.train import OccupancyTask
from omniocc.train.build import build_task
from omniworld.source import world_spec

os.environ.setdefault("OMP_NUM_THREADS", "1")
torch.set_num_threads(1)

ROOT = Path(__file__).parents[1]
TESTS = Path(__file__).parent
# folders of helpers: scripts, second_device; offline_file; wandb_server; plain_shading; batches; metric_batches;
# by_hand; made_scenes; made_runs; recordings
sys.path[:0] = [
    str(TESTS),
    *(
        str(TESTS / folder)
        for folder in (
            "runs/wandb",
            "report/wandb",
            "omniworld/render",
            "train",
            "rayiou",
            "model/lifter",
            "data",
            "data/formats",
            "extras/viewer",
            "extras/viewer/watch",
            "extras/viewer/timeline",
            "browser",
        )
    ),
]


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests first, so that at the end no process is left alone with one (short ones move to an idle process)."""
    items.sort(key=seconds_of, reverse=True)


def seconds_of(item: pytest.Item) -> float:
    """Return about how long a test takes, in seconds: what its marker `slow` says, or 10, and 0 without one."""
    marker = item.get_closest_marker("slow")
    return 0 if marker is None else next(iter(marker.args), 10)


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory) -> Path:
    """Return a folder that is the same in all test processes."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base


@pytest.fixture(scope="session")
def data_root(shared_folder) -> Path:
    """Return the folder of rendered data that all test processes share; the dataset's own lock keeps them apart."""
    return shared_folder / "data"


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_the_disk() -> Iterator[None]:
    """Do not flush files to the disk, which no test can see: that took a tenth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture(scope="session")
def samples() -> Path:
    """Return the folder of real samples of public datasets, which may not be copied here; skip the test without it."""
    folder = os.environ.get("OMNIOCC_SAMPLES")
    if folder is None:
        pytest.skip("real samples of public datasets are not in the repository: OMNIOCC_SAMPLES names their folder")
    return Path(folder)


@functools.cache
def compose_once(name: str, overrides: tuple[str, ...]) -> DictConfig:
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return compose(name, list(overrides))


@pytest.fixture(scope="session")
def composed() -> Callable[..., DictConfig]:
    """Compose a configuration; the same one is composed once in a process, every caller gets a copy."""

    def get(*overrides: str, name: str = "train") -> DictConfig:
        return copy.deepcopy(compose_once(name, overrides))

    return get


@pytest.fixture(scope="session")
def as_trained() -> Callable[[OccupancyModel], OccupancyModel]:
    """Return a function that gives a model's classifier random weights and counts, as if it had been trained."""

    def change(model: OccupancyModel) -> OccupancyModel:
        classifier = model.classifier
        torch.nn.init.normal_(classifier.linear.weight)
        counts = torch.randint(0, 9, (classifier.linear.out_features, *model.geometry.shape))
        classifier.set_class_counts(counts)
        return model

    return change


@pytest.fixture
def little_memory() -> Iterator[None]:
    """Let this process take half a GiB more than it has."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + 2**29, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.fixture(scope="session")
def spec() -> SourceSpec:
    """Return the spec of the virtual world."""
    return world_spec(0.5)


@pytest.fixture(scope="session")
def smoke(composed) -> Callable[..., DictConfig]:
    """Compose `train.yaml` at the smallest sizes."""
    return functools.partial(composed, "preset=smoke")


@pytest.fixture(scope="session")
def make_task(smoke, spec) -> Callable[..., OccupancyTask]:
    """Build the task of the last stage at the smallest sizes."""

    def make(*overrides: str) -> OccupancyTask:
        torch.manual_seed(0)
        return build_task(Parts(smoke(*overrides)), spec)

    return make


@pytest.fixture(scope="session")
def losses() -> Callable[..., list[float]]:
    """Train a network on one batch for 15 steps, and return the loss of every step."""

    def train(network: nn.Module, loss_of: Callable[[], Tensor]) -> list[float]:
        optimizer, values = torch.optim.Adam(network.parameters(), 0.01), []
        for _ in range(15):
            optimizer.zero_grad()
            loss = loss_of()
            loss.backward()
            optimizer.step()
            values.append(loss.item())
        return values

    return train
