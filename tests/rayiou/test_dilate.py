import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder

CYLINDER = Cylinder(shape=(20, 12, 3), radius_m=(0.0, 20.0), height_m=(-1.0, 2.0))
CUBOID = Cuboid(shape=(41, 41, 3), x_m=(-20.5, 20.5), y_m=(-20.5, 20.5), height_m=(-1.0, 2.0))
WINDOWS, EDGES_M = (0, 1, 3), (8.0, 15.0)


def random_mask(grid, seed, fraction=0.02):
    return torch.rand(2, *grid.shape, generator=torch.Generator().manual_seed(seed)) < fraction


def test_a_cylinder_widens_along_r_by_the_window_of_the_band():
    mask = random_mask(CYLINDER, 0)
    expected = torch.zeros_like(mask)
    for b, r, theta, z in mask.nonzero().tolist():
        window = WINDOWS[(r + 0.5 >= 8.0) + (r + 0.5 >= 15.0)]
        expected[b, max(r - window, 0) : r + window + 1, theta, z] = True
    assert torch.equal(CYLINDER.dilate(mask, WINDOWS, EDGES_M), expected)


def test_turning_the_mask_turns_the_result():
    mask = random_mask(CYLINDER, 1)
    for turn in (1, 5, -3):
        turned = CYLINDER.dilate(mask.roll(turn, dims=2), WINDOWS, EDGES_M)
        assert torch.equal(turned, CYLINDER.dilate(mask, WINDOWS, EDGES_M).roll(turn, dims=2))
    # in the cuboid quarter turns are exact
    mask = random_mask(CUBOID, 2)
    turned = CUBOID.dilate(mask.rot90(1, dims=(1, 2)), WINDOWS, EDGES_M)
    assert torch.equal(turned, CUBOID.dilate(mask, WINDOWS, EDGES_M).rot90(1, dims=(1, 2)))


def test_a_cuboid_widens_along_the_ray():
    mask = torch.zeros(CUBOID.shape, dtype=torch.bool)
    mask[20 + 10, 20, 1] = True  # 10 m ahead: one cell on either side
    mask[20, 20 - 16, 2] = True  # 16 m to the right: three
    mask[20 + 12, 20 + 12, 0] = True  # 17 m away on the diagonal: three steps of 0.71 cells along each axis
    marked = CUBOID.dilate(mask, WINDOWS, EDGES_M).nonzero().sub(torch.tensor([20, 20, 0])).tolist()
    diagonal = [[d, d, 0] for d in (10, 11, 12, 13, 14)]
    ahead, right = [[d, 0, 1] for d in (9, 10, 11)], [[0, d, 2] for d in range(-19, -12)]
    assert sorted(marked) == sorted(diagonal + ahead + right)


def test_a_step_along_the_ray_is_the_shorter_side_of_a_cell():
    """Cells of 1 m by 0.5 m: no cell to the left of the car is left out, and none is counted twice ahead of it."""
    grid = Cuboid(shape=(21, 41, 1), x_m=(-10.5, 10.5), y_m=(-10.25, 10.25), height_m=(0.0, 1.0))
    left, ahead = torch.zeros(grid.shape, dtype=torch.bool), torch.zeros(grid.shape, dtype=torch.bool)
    left[10, 20 + 10] = ahead[10 + 5, 20] = True
    marked = grid.dilate(left, (2,), ()).nonzero() - torch.tensor([10, 20, 0])
    assert marked.tolist() == [[0, d, 0] for d in (8, 9, 10, 11, 12)]
    marked = grid.dilate(ahead, (2,), ()).nonzero() - torch.tensor([10, 20, 0])
    assert marked.tolist() == [[d, 0, 0] for d in (4, 5, 6)]


def test_marks_are_near_the_ray_and_within_the_window():
    mask = torch.zeros(CUBOID.shape, dtype=torch.bool)
    mask[33, 27, 1] = True
    marked = CUBOID.centers()[CUBOID.dilate(mask, (2,), ())]
    source = torch.tensor([13.0, 7.0])
    along = marked[:, :2] @ (source / source.norm())
    across = (marked[:, 0] * source[1] - marked[:, 1] * source[0]) / source.norm()
    assert (along - source.norm()).abs().max() < 2.71
    assert across.abs().max() < 0.71
    assert 4 <= len(marked) <= 5


def test_cells_behind_are_marked_away_from_the_axis_only():
    mask = torch.zeros(CYLINDER.shape, dtype=torch.bool)
    mask[4, 3, 1] = True
    assert CYLINDER.dilate(mask, (1,), (), behind=2).nonzero().tolist() == [[r, 3, 1] for r in (3, 4, 5, 6, 7)]
    mask = torch.zeros(CUBOID.shape, dtype=torch.bool)
    mask[20 - 8, 20, 1] = True
    assert CUBOID.dilate(mask, (0,), (), behind=1).nonzero().tolist() == [[11, 20, 1], [12, 20, 1]]


def test_no_mark_crosses_the_axis():
    mask = torch.zeros(CYLINDER.shape, dtype=torch.bool)
    mask[1, 3, 1] = True
    assert CYLINDER.dilate(mask, (5,), ()).nonzero()[:, 1].unique().tolist() == [3]
    mask = torch.zeros(CUBOID.shape, dtype=torch.bool)
    mask[22, 20, 1] = True
    assert CUBOID.dilate(mask, (5,), ()).nonzero()[:, 0].min() == 20


def test_many_marks_on_one_cell_do_not_overflow():
    assert CUBOID.dilate(torch.ones(CUBOID.shape, dtype=torch.bool), (9,), ()).all()


@pytest.mark.parametrize(
    ("mask", "windows", "edges_m", "message"),
    [
        ((2, 20, 12, 4), (0,), (), r"mask.*\(20, 12, 3\).*\(2, 20, 12, 4\)"),
        ((20, 12, 3), (0, 1), (), r"one more window.*\(0, 1\).*edges_m \(\)"),
        ((20, 12, 3), (0, -1), (5.0,), "none negative"),
        ((20, 12, 3), (0, 1, 2), (5.0, 4.0), "must increase.*edges_m"),
    ],
)
def test_error_names_wrong_input(mask, windows, edges_m, message):
    with pytest.raises(ValueError, match=message):
        CYLINDER.dilate(torch.zeros(mask, dtype=torch.bool), windows, edges_m)
