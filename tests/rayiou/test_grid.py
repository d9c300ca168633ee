import itertools
import math
import pickle

import numpy as np
import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder

SMALL = [
    Cylinder(shape=(5, 12, 4), radius_m=(0.0, 10.0), height_m=(-2.0, 2.0)),
    Cylinder(shape=(4, 7, 3), radius_m=(2.0, 8.0), height_m=(-1.0, 2.0)),
    Cuboid(shape=(6, 5, 4), x_m=(-6.0, 6.0), y_m=(-5.0, 5.0), height_m=(-2.0, 2.0)),
]


@pytest.mark.parametrize("grid", SMALL)
def test_centers_lie_in_their_own_cells(grid):
    index, inside = grid.index(grid.centers())
    assert inside.all()
    expected = torch.stack(torch.meshgrid(*[torch.arange(n) for n in grid.shape], indexing="ij"), dim=-1)
    assert torch.equal(index, expected)
    flat, _ = grid.flat_index(grid.centers(torch.float64))
    assert torch.equal(flat.flatten(), torch.arange(grid.num_cells))


@pytest.mark.parametrize("grid", SMALL)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_index_agrees_with_a_plain_loop(grid, dtype):
    points = (torch.rand(3000, 3, generator=torch.Generator().manual_seed(0), dtype=dtype) - 0.5) * 24
    index, inside = grid.index(points)
    for point, cell, within in zip(points.tolist(), index.tolist(), inside.tolist(), strict=True):
        if isinstance(grid, Cylinder):
            values = (math.hypot(point[0], point[1]), math.atan2(point[1], point[0]), point[2])
        else:
            values = tuple(point)
        expected = [
            math.floor((value - low) / (high - low) * cells)
            for value, (low, high), cells in zip(values, grid.bounds, grid.shape, strict=True)
        ]
        assert within == all(0 <= i < n for i, n in zip(expected, grid.shape, strict=True))
        if within:
            assert cell == expected


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_the_seam_never_gives_an_index_outside(dtype):
    grid = Cylinder()
    tiny = torch.tensor([0.0, -0.0, 1e-7, -1e-7, 1e-12, -1e-12, 1e-30, -1e-30], dtype=torch.float64)
    seam = torch.stack([-torch.ones(8, dtype=torch.float64), tiny, 0 * tiny], dim=-1).to(dtype)
    index, inside = grid.index(seam)
    assert inside.all()
    assert ((index[:, 1] == 0) | (index[:, 1] == 199)).all()
    # +pi (y = +0) and -pi (y = -0) are the same direction and both open index 0
    assert index[0, 1] == 0
    assert index[1, 1] == 0
    assert index[4, 1] == (199 if dtype == torch.float64 else 0)


def test_ranges_are_half_open_and_floor_is_not_truncation():
    grid = Cuboid(shape=(4, 4, 4), x_m=(0.0, 4.0), y_m=(0.0, 4.0), height_m=(0.0, 4.0))
    points = torch.tensor([[0.0, 0, 0], [-0.5, 1, 1], [4.0, 1, 1], [3.999, 1, 1], [1, 2, 3], [1, 1, -1e-6]])
    index, inside = grid.index(points)
    assert inside.tolist() == [True, False, False, True, True, False]
    assert index[[0, 3, 4]].tolist() == [[0, 0, 0], [3, 1, 1], [1, 2, 3]]
    assert index[1].tolist() == [0, 1, 1]


@pytest.mark.parametrize("grid", SMALL)
def test_points_that_are_not_finite_are_outside(grid):
    bad = torch.tensor([[math.nan, 0, 0], [0, math.inf, 0], [0, 0, -math.inf], [math.nan, math.nan, math.nan]])
    index, inside = grid.index(bad)
    assert not inside.any()
    assert ((index >= 0) & (index < torch.tensor(grid.shape))).all()


def test_paper_grids():
    assert Cylinder().num_cells == 409_600
    assert Cylinder().cell_m == pytest.approx((0.2, 2 * math.pi * 12.8 / 200, 0.4))
    assert Cuboid().num_cells == 1_048_576
    assert Cuboid().cell_m == pytest.approx((0.2, 0.2, 0.4))
    assert Cylinder().periodic == (False, True, False)
    # the road at -2.2 m lies in the middle of a cell
    assert Cylinder().coordinates(torch.tensor([1.0, 0.0, -2.2]))[2].item() == pytest.approx(1.5)


def test_equal_grids_have_equal_hashes_and_lists_are_accepted():
    assert Cylinder(shape=[64, 100, 8], radius_m=[0, 25.6], height_m=[-2.8, 3.6]) == Cylinder(shape=(64, 100, 8))
    assert hash(Cuboid(shape=[8, 8, 8])) == hash(Cuboid(shape=(8, 8, 8)))
    assert Cuboid(shape=(8, 8, 8)) != Cuboid(shape=(8, 8, 4))
    assert pickle.loads(pickle.dumps(Cylinder())) == Cylinder()


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Cylinder(shape=(0, 4, 4)), "shape.*positive"),
        (lambda: Cuboid(shape=(4, 4)), "shape.*positive"),
        (lambda: Cylinder(radius_m=(-1.0, 4.0)), "radius_m.*negative"),
        (lambda: Cylinder(height_m=(2.0, 1.0)), "height_m.*increasing"),
        (lambda: Cuboid(x_m=(0.0, float("nan"))), "x_m.*finite"),
        (lambda: Cuboid(y_m=(0.0, 1.0, 2.0)), "y_m.*two"),
    ],
)
def test_impossible_grids_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


@pytest.mark.parametrize("grid", SMALL)
def test_voxelize_agrees_with_a_plain_loop(grid):
    generator = torch.Generator().manual_seed(1)
    points = (torch.rand(2000, 3, generator=generator) - 0.5) * 22
    labels = torch.randint(1, 5, (2000,), generator=generator, dtype=torch.uint8)
    labels[::7] = 255
    voxels = grid.voxelize(points, labels)
    index, inside = grid.index(points)
    votes: dict[tuple[int, ...], list[int]] = {}
    for cell, label, within in zip(index.tolist(), labels.tolist(), inside.tolist(), strict=True):
        if within:
            votes.setdefault(tuple(cell), []).append(label)
    expected = np.zeros(grid.shape, dtype=np.uint8)
    for cell, cell_labels in votes.items():
        known = [label for label in cell_labels if label != 255]
        expected[cell] = max(known, key=lambda label: (known.count(label), label)) if known else 255
    np.testing.assert_array_equal(voxels.numpy(), expected)
    assert (voxels == 255).any()


def test_rules_of_voxelize():
    grid = Cuboid(shape=(4, 1, 1), x_m=(0.0, 4.0), y_m=(0.0, 1.0), height_m=(0.0, 1.0))
    points = torch.tensor([[0.5, 0.5, 0.5]] * 4 + [[1.5, 0.5, 0.5]] * 3 + [[2.5, 0.5, 0.5]] * 2 + [[9.0, 9.0, 9.0]])
    labels = torch.tensor([1, 1, 11, 11, 1, 255, 255, 255, 255, 3], dtype=torch.uint8)
    assert grid.voxelize(points, labels).flatten().tolist() == [11, 1, 255, 0]
    assert grid.voxelize(points[:0], labels[:0]).flatten().tolist() == [0, 0, 0, 0]
    for label in (0, 12, 254):
        with pytest.raises(ValueError, match=f"labels.*\\[{label}\\]"):
            grid.voxelize(points[:1], torch.tensor([label], dtype=torch.uint8))


def test_volumes_fill_the_grid():
    cylinder = Cylinder(shape=(6, 9, 4), radius_m=(3.0, 12.0), height_m=(-2.0, 2.0))
    cuboid = Cuboid(shape=(8, 7, 5), x_m=(-8.0, 8.0), y_m=(-7.0, 7.0), height_m=(-2.0, 3.0))
    assert cylinder.volumes_m3().sum().item() == pytest.approx(math.pi * (144 - 9) * 4)
    assert cylinder.volumes_m3()[5, 0, 0].item() == pytest.approx(math.pi / 9 * (144 - 10.5**2))
    assert cuboid.volumes_m3().sum().item() == pytest.approx(16 * 14 * 5)
    assert cuboid.volumes_m3().shape == (8, 7, 5)


def test_distances_of_columns():
    cylinder = Cylinder(shape=(6, 9, 4), radius_m=(3.0, 12.0), height_m=(-2.0, 2.0))
    torch.testing.assert_close(cylinder.distances_m()[:, 4], torch.arange(3.75, 12, 1.5, dtype=torch.float64))
    cuboid = Cuboid(shape=(8, 7, 5), x_m=(-8.0, 8.0), y_m=(-7.0, 7.0), height_m=(-2.0, 3.0))
    assert cuboid.distances_m()[7, 0].item() == pytest.approx(math.hypot(7, 6))


@pytest.mark.parametrize("grid", SMALL)
def test_neighbors_are_the_cells_one_step_along_each_axis(grid):
    found = grid.neighbors()
    for cell in itertools.product(*map(range, grid.shape)):
        expected = []
        for axis, step in itertools.product(range(3), (-1, 1)):
            other = list(cell)
            other[axis] += step
            if grid.periodic[axis]:
                other[axis] %= grid.shape[axis]
            inside = 0 <= other[axis] < grid.shape[axis]
            expected.append((other[0] * grid.shape[1] + other[1]) * grid.shape[2] + other[2] if inside else -1)
        assert found[cell].tolist() == expected


def test_points_within_the_sides_are_more_than_the_margin_inside_of_all_of_them():
    cuboid = Cuboid((8, 4, 4), (-40.0, 40.0), (-20.0, 20.0), (-2.0, 2.0))
    along = torch.tensor([[38.9, 0, 9], [39, 0, 0], [-38.9, 0, 0], [-39.5, 0, 0]])
    across = torch.tensor([[0, 18.9, 9], [0, 19, 0], [0, -18.9, 0], [0, -19.5, 0]])
    for points in (along, across):
        assert cuboid.within_sides(points, 1.0).tolist() == [True, False, True, False]
    cylinder = Cylinder((8, 4, 4), (10.0, 40.0), (-2.0, 2.0))
    points = torch.tensor([[38.9, 0, 9], [28, 28, 0], [0, -39, 0], [1, 0, 0]])  # 39.6 m on the diagonal
    assert cylinder.within_sides(points, 1.0).tolist() == [True, False, False, True]


def test_a_grid_reaches_beyond_a_distance_if_it_does_so_ahead_or_to_the_left():
    assert [Cylinder().reaches_beyond(distance_m) for distance_m in (25.5, 25.6)] == [True, False]
    ahead = Cuboid((8, 8, 2), (0.0, 51.2), (-25.6, 25.6), (-2.0, 4.4))
    assert [ahead.reaches_beyond(distance_m) for distance_m in (51.1, 51.2)] == [True, False]
    assert not Cuboid().reaches_beyond(25.6), "corners do not count"
