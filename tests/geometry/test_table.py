import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder, ray_table

GRIDS = [
    Cylinder(shape=(24, 30, 6), radius_m=(0.0, 14.0), height_m=(-2.0, 3.0)),
    Cylinder(shape=(12, 9, 4), radius_m=(3.0, 12.0), height_m=(-2.0, 2.0)),
    Cuboid(shape=(20, 20, 8), x_m=(-10.0, 10.0), y_m=(-10.0, 10.0), height_m=(-4.0, 4.0)),
]


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("share", [0.0, 0.01, 0.2, 1.0])
def test_a_table_finds_what_stepping_finds(grid, share):
    generator = torch.Generator().manual_seed(0)
    origins = (torch.rand(3000, 3, generator=generator) - 0.5) * 24
    directions = torch.randn(3000, 3, generator=generator)
    labels = torch.randint(1, 256, grid.shape, generator=generator, dtype=torch.uint8)
    labels[torch.rand(grid.shape, generator=generator) >= share] = 0
    for mine, theirs in zip(
        ray_table(grid, origins, directions).cast(labels), grid.cast(labels, origins, directions), strict=True
    ):
        assert torch.equal(mine, theirs)


def test_equal_rays_and_grids_share_a_table():
    origins, directions = torch.zeros(4, 3), torch.randn(4, 3)
    table = ray_table(Cuboid(shape=(4, 4, 4)), origins, directions)
    assert ray_table(Cuboid(shape=[4, 4, 4]), origins.clone(), directions.clone()) is table
    assert ray_table(Cuboid(shape=(4, 4, 4)), origins + 1, directions) is not table
    assert ray_table(Cuboid(shape=(4, 4, 2)), origins, directions) is not table


def test_labels_of_another_grid_are_refused():
    table = ray_table(GRIDS[0], torch.zeros(1, 3), torch.ones(1, 3))
    with pytest.raises(ValueError, match=r"labels must have 4320 cells, got shape \(2, 2, 2\)"):
        table.cast(torch.zeros(2, 2, 2, dtype=torch.uint8))
