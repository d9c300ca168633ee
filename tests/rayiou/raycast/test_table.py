import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder, RayScan, ray_table
from omniocc.metric import sparseocc_directions
from rayiou.raycast.fans import RayFans
from rayiou.raycast.table import RayTable, TensorTable

GRIDS = [
    Cylinder(shape=(24, 30, 6), radius_m=(0.0, 14.0), height_m=(-2.0, 3.0)),
    Cylinder(shape=(12, 9, 4), radius_m=(3.0, 12.0), height_m=(-2.0, 2.0)),
    Cuboid(shape=(20, 20, 8), x_m=(-10.0, 10.0), y_m=(-10.0, 10.0), height_m=(-4.0, 4.0)),
    Cuboid(shape=(9, 12, 48), x_m=(-9.0, 9.0), y_m=(-6.0, 6.0), height_m=(-5.0, 5.0)),
]


def first_hits(grid, labels, origins, directions):
    """Return the first occupied cell along `Grid.paths`, which is tested against brute force."""
    found = grid.paths(origins, directions)
    path_labels = torch.where(found.cells >= 0, labels.flatten()[found.cells.clamp(min=0).long()], 0)
    column = (path_labels != 0).float().argmax(dim=1)
    hit = (path_labels != 0).any(dim=1)
    rows = torch.arange(len(path_labels))
    leave_m = torch.where(found.valid, found.bounds_m[:, -1], torch.inf)
    return (
        torch.where(hit, found.cells[rows, column], -1),
        torch.where(hit, path_labels[rows, column], 0),
        torch.where(hit, found.entry_m[rows, column], leave_m),
        torch.where(hit, found.exit_m[rows, column], leave_m),
    )


class OnTensors(RayTable):
    """Return a table as on a GPU."""

    def __init__(self, grid, fans):
        super().__init__(grid, fans)
        self.table = TensorTable(grid, fans)


BOTH = [RayTable, OnTensors]


def check_same(hits, expected):
    assert torch.equal(hits.cells, expected[0])
    assert torch.equal(hits.labels, expected[1])
    torch.testing.assert_close(hits.entry_m, expected[2], rtol=0, atol=4e-6)
    torch.testing.assert_close(hits.exit_m, expected[3], rtol=0, atol=4e-6)


def random_labels(grid, occupancy, generator):
    labels = torch.randint(1, 256, grid.shape, generator=generator, dtype=torch.uint8)
    labels[torch.rand(grid.shape, generator=generator) >= occupancy] = 0
    return labels


@pytest.mark.parametrize("table", BOTH)
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("occupancy", [0.0, 0.01, 0.2, 1.0])
def test_single_rays(grid, occupancy, table):
    generator = torch.Generator().manual_seed(0)
    origins = ((torch.rand(3000, 3, generator=generator) - 0.5) * 24).double()
    directions = torch.randn(3000, 3, generator=generator).double()
    directions[:200, :2] = 0  # vertical
    directions[200:400, 2] = 0  # level
    labels = random_labels(grid, occupancy, generator)
    rays, expected = table(grid, RayFans.from_rays(origins, directions)), first_hits(grid, labels, origins, directions)
    for _ in range(3):  # the columns are found, found and kept, and reused
        hits = rays.cast(labels)
        check_same(hits, expected)
    if table is RayTable:
        for mine, theirs in zip(grid.cast(labels, origins, directions), hits, strict=True):
            assert torch.equal(mine, theirs)


@pytest.mark.parametrize("table", BOTH)
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("occupancy", [0.005, 0.2])
def test_lidar_raster_agrees_with_single_rays(grid, occupancy, table):
    generator = torch.Generator().manual_seed(1)
    scan = RayScan(sparseocc_directions().reshape(39, 360, 3)[::2, ::7].reshape(-1, 3))
    assert scan.raster is not None
    origins = (torch.rand(9, 3, generator=generator, dtype=torch.float64) - 0.5) * torch.tensor([24.0, 24.0, 8.0])
    origins[0] = 0  # on the axis
    origins[1] = torch.tensor([2.0, 0.0, -2.0])  # on faces
    labels = random_labels(grid, occupancy, generator)
    expected = first_hits(grid, labels, *scan.rays(origins))
    rays = table(grid, scan.fans(origins))
    for _ in range(3):  # the columns are found, found and kept, and reused
        check_same(rays.cast(labels), expected)
    torch.testing.assert_close(rays.reach_m, first_hits(grid, labels * 0, *scan.rays(origins))[2], rtol=0, atol=4e-6)


def test_the_public_rays_on_the_papers_grids():
    generator = torch.Generator().manual_seed(2)
    scan = RayScan(sparseocc_directions())
    origins = torch.tensor([[0.0, 0.0, 0.0], [-3.7, 11.3, 0.4]], dtype=torch.float64)
    for grid in (Cylinder(), Cuboid()):
        labels = random_labels(grid, 0.01, generator)
        hits = RayTable(grid, scan.fans(origins)).cast(labels)
        assert (hits.cells >= 0).float().mean() > 0.5
        check_same(hits, first_hits(grid, labels, *scan.rays(origins)))


def test_several_volumes_at_once():
    generator = torch.Generator().manual_seed(3)
    volumes = [random_labels(GRIDS[0], occupancy, generator) for occupancy in (0.01, 0.1, 0.0)]
    table = ray_table(GRIDS[0], torch.zeros(2, 3), RayScan(sparseocc_directions()[::11]))
    for labels, hits in zip(volumes, table.cast_all(volumes), strict=True):
        for mine, theirs in zip(hits, table.cast(labels), strict=True):
            assert torch.equal(mine, theirs)


def test_equal_rays_and_grids_use_one_table():
    origins, directions = torch.zeros(2, 3), torch.randn(4, 3)
    scan = RayScan(directions)
    table = ray_table(Cuboid(shape=(4, 4, 4)), origins, scan)
    assert ray_table(Cuboid(shape=[4, 4, 4]), origins.double(), RayScan(directions.clone())) is table
    assert ray_table(Cuboid(shape=(4, 4, 4)), origins + 1, scan) is not table
    assert ray_table(Cuboid(shape=(4, 4, 4)), origins, RayScan(-directions)) is not table
    assert ray_table(Cuboid(shape=(4, 4, 2)), origins, scan) is not table


def test_error_names_wrong_input():
    table = ray_table(GRIDS[0], torch.zeros(1, 3), RayScan(torch.ones(1, 3)))
    with pytest.raises(ValueError, match=r"labels.*\(24, 30, 6\).*\(2, 2, 2\)"):
        table.cast(torch.zeros(2, 2, 2, dtype=torch.uint8))
    with pytest.raises(ValueError, match=r"48 levels.*\(2, 2, 49\)"):
        RayTable(Cuboid(shape=(2, 2, 49)), RayFans.from_rays(torch.zeros(1, 3), torch.ones(1, 3)))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e300])
@pytest.mark.parametrize("grid", GRIDS)
def test_rays_that_are_not_finite_hit_nothing(grid, bad):
    origins = torch.zeros(6, 3, dtype=torch.float64)
    directions = torch.ones(6, 3, dtype=torch.float64)
    for axis in range(3):
        origins[axis, axis] = bad
        directions[3 + axis, axis] = bad
    hits = grid.cast(torch.ones(grid.shape, dtype=torch.uint8), origins, directions)
    assert hits.labels[:3].tolist() == [0, 0, 0]
    assert (hits.cells < grid.num_cells).all()
