"""Origins of RayIoU's rays in samples and batches: those of a dataset, the ego origin, or where the car was."""

import pytest
import torch
from fake_scene import FakeWorld

from omniocc.data import OccupancyData
from omniocc.data.dataset import WindowDataset, collate
from omniocc.data.labels.voxels import VoxelCache
from omniocc.data.origins import choose_origins, scene_origins
from omniocc.data.source import BenchmarkFrame
from omniocc.geometry import Cylinder
from rayiou.directions import RayOrigins

GRID = Cylinder(shape=(8, 10, 4), radius_m=(0.0, 8.0), height_m=(-2.8, 3.6))
OWN = RayOrigins(torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64), torch.tensor([-4]))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Four frames a scene, each 3 m ahead of the one before."""
    world = FakeWorld(tmp_path_factory.mktemp("world"))
    world.prepare()
    return world


def samples(world, origins, benchmark=None):
    labels = VoxelCache(world.folder, GRID, fingerprint="fingerprint")
    labels.prepare(world.scenes("train"))
    labels.benchmark = lambda scene, frame: benchmark
    return WindowDataset(world.scenes("train"), labels, 1, origins=origins, scored_grid=GRID)


def test_rays_start_where_the_car_was_within_the_grid(world):
    data = samples(world, "trajectory")
    for index, ahead in enumerate(([0, 3, 6], [-3, 0, 3, 6], [-6, -3, 0, 3], [-6, -3, 0])):
        sample = data[index]
        assert sample.ray_origins.dtype == torch.float32
        assert sample.ray_origins.tolist() == [[float(x), 0.0, 0.0] for x in ahead]
        assert sample.ray_times.tolist() == [x // 3 for x in ahead]
    found = scene_origins(world.scenes("train")[0], 1, GRID)
    assert (found.positions_m.dtype, found.times.tolist()) == (torch.float64, [-1, 0, 1, 2])


def test_frames_with_fewer_origins_are_filled_with_nan(world):
    data = samples(world, "trajectory")
    batch = collate([data[0], data[1]])
    assert batch.ray_origins.shape == (2, 4, 3)
    assert batch.ray_origins[:, :, 0].isnan().tolist() == [[False, False, False, True], [False] * 4]
    assert batch.ray_times.tolist() == [[0, 1, 2, 0], [-1, 0, 1, 2]]


@pytest.mark.parametrize(
    ("origins", "own", "expected"),
    [("own", OWN, OWN), ("own", None, None), ("ego", OWN, None), ("ego", None, None), ("trajectory", OWN, OWN)],
)
def test_choice(world, origins, own, expected):
    assert choose_origins(origins, own, world.scenes("train")[0], 0, GRID) is expected
    voxels = torch.zeros(GRID.shape, dtype=torch.uint8)
    sample = samples(world, origins, None if own is None else BenchmarkFrame(voxels, ray_origins=own))[0]
    if expected is None:
        assert sample.ray_origins is None
        assert sample.ray_times is None
    else:
        assert sample.ray_origins.tolist() == [[1.0, 2.0, 3.0]]
        assert sample.ray_times.tolist() == [-4]


def test_the_module_casts_from_the_chosen_origins_of_its_grid(world):
    data = OccupancyData(world, 12, GRID, 1, batch_size=4, num_workers=0, seed=0)
    data.prepare_data()
    data.setup()
    assert data.dataset("train")[1].ray_origins is None
    data.set_ray_origins("trajectory")
    data.setup()
    (batch,) = data.in_order("test")
    assert batch.ray_times.tolist() == [[0, 1, 2, 0], [-1, 0, 1, 2], [-2, -1, 0, 1], [-2, -1, 0, 0]]
    finite = batch.ray_origins[batch.ray_origins.isfinite().all(-1)]
    assert len(finite) == 14
    assert finite[:, :2].norm(dim=1).max() < 7
    data.set_ray_origins("own")
    data.setup()
    assert data.dataset("train")[1].ray_origins is None


def test_origins_to_look_for_need_a_grid(world):
    with pytest.raises(ValueError, match="origins='trajectory' needs scored_grid"):
        WindowDataset(world.scenes("train"), None, 1, origins="trajectory")
