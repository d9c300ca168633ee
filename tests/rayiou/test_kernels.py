"""The compiled kernels in threads, in forked processes, and without a writable folder."""

import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import torch
from torch.utils.data import DataLoader

import rayiou
from omniocc.geometry import Cuboid, Cylinder, RayScan, RayTable
from omniocc.metric import sparseocc_directions
from rayiou.raycast.table import run_in_threads

GRID = Cylinder((16, 20, 6), (0.0, 12.0), (-2.8, 3.2))
COMPILE = (
    "from rayiou.raycast import march; print(march.__file__, *march.clip_flat(0.25, 1.0, 0.0, 1.0));"
    "print(march.clip_flat.stats.cache_path)"
)


def labels_of(seed):
    labels = torch.zeros(GRID.shape, dtype=torch.uint8)
    labels[torch.rand(GRID.shape, generator=torch.Generator().manual_seed(seed)) < 0.05] = 4
    return labels


def table_of():
    return RayTable(GRID, RayScan(sparseocc_directions()).fans(torch.zeros(1, 3)))


class Casts:
    """A dataset that casts rays."""

    def __len__(self):
        return 4

    def __getitem__(self, index):
        torch.get_num_threads = lambda: 2  # torch itself must not start threads in a forked process
        return table_of().cast(labels_of(index)).cells


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_calls_from_several_threads_at_once(two_threads):
    expected = [table_of().cast(labels_of(seed)) for seed in range(4)]
    shared, wrong = table_of(), []

    def work(seed):
        for _ in range(5):
            found = [rays.cast(labels_of(seed)).cells for rays in (shared, table_of())]
            wrong.extend(seed for cells in found if not torch.equal(cells, expected[seed].cells))

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_calls_in_forked_workers_after_one_in_the_parent(two_threads):
    expected = [table_of().cast(labels_of(seed)).cells for seed in range(4)]
    loader = DataLoader(Casts(), batch_size=None, num_workers=2, multiprocessing_context="fork")
    for found, cells in zip(loader, expected, strict=True):
        assert torch.equal(found, cells)


def test_the_number_of_threads_changes_nothing(two_threads):
    found = table_of().cast(labels_of(0))
    torch.set_num_threads(1)
    for mine, theirs in zip(table_of().cast(labels_of(0)), found, strict=True):
        assert torch.equal(mine, theirs)


def test_work_is_done_once_and_errors_are_raised(two_threads):
    done_work = []
    run_in_threads(lambda first, last: done_work.extend(range(first, last)), 1000, 10**6)
    assert sorted(done_work) == list(range(1000))
    run_in_threads(lambda first, last: done_work.append((first, last)), 0, 0)
    assert done_work[-1] == (0, 0)

    def fail(first, last):
        raise KeyError(first)

    with pytest.raises(KeyError):
        run_in_threads(fail, 1000, 10**6)


def test_install_without_a_writable_folder(tmp_path):
    """Compile kernels for one process in a read-only install without a home folder."""
    source = Path(rayiou.__file__).parent
    shutil.copytree(source, tmp_path / "rayiou", ignore=shutil.ignore_patterns("__pycache__"))
    raycast = tmp_path / "rayiou" / "raycast"
    # files in place of the cache folders, since a superuser may write anywhere
    (raycast / "__pycache__").touch()
    (tmp_path / "home").touch()
    home = str(tmp_path / "home")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "HOME": home, "XDG_CACHE_HOME": home}
    environment |= {"NUMBA_CACHE_DIR": "", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-c", COMPILE], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(raycast / "march.py"), "-0.25", "0.75", "None"]


def test_a_cuboid_of_one_cell():
    grid = Cuboid((1, 1, 1), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0))
    hits = grid.cast(torch.ones(1, 1, 1, dtype=torch.uint8), torch.full((1, 3), 0.5), torch.tensor([[1.0, 0.0, 0.0]]))
    assert (hits.cells.item(), hits.entry_m.item(), hits.exit_m.item()) == (0, 0.0, 0.5)
