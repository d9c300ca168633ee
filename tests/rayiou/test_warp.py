import math

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder

CYLINDER = Cylinder(shape=(8, 20, 6), radius_m=(0.0, 16.0), height_m=(-3.0, 3.0))
RING = Cylinder(shape=(6, 9, 4), radius_m=(2.0, 14.0), height_m=(-2.0, 2.0))
CUBOID = Cuboid(shape=(10, 8, 6), x_m=(-10.0, 10.0), y_m=(-8.0, 8.0), height_m=(-3.0, 3.0))


def turn(angle_rad: float, shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> torch.Tensor:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:2, :2] = torch.tensor(
        [[math.cos(angle_rad), -math.sin(angle_rad)], [math.sin(angle_rad), math.cos(angle_rad)]]
    )
    pose[:3, 3] = torch.tensor(shift_m)
    return pose[None]


@pytest.mark.parametrize("grid", [CYLINDER, RING, CUBOID])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
def test_no_motion_changes_no_bit(grid, dtype):
    volume = torch.randn(2, 3, *grid.shape).to(dtype)
    pose = torch.eye(4, dtype=torch.float64).expand(2, 4, 4)
    assert torch.equal(grid.warp(volume, pose), volume)
    assert grid.warp_valid(pose).all()


@pytest.mark.parametrize("cells", [1, 7, -3])
def test_turning_the_cylinder_by_whole_cells_is_a_roll(cells):
    volume = torch.randn(1, 2, *CYLINDER.shape, dtype=torch.float64)
    pose = turn(cells * 2 * math.pi / 20)
    torch.testing.assert_close(CYLINDER.warp(volume, pose), volume.roll(-cells, dims=3), rtol=0, atol=1e-12)


def test_moving_the_cuboid_by_whole_cells_is_a_shift():
    volume = torch.randn(1, 2, *CUBOID.shape, dtype=torch.float64)
    warped = CUBOID.warp(volume, turn(0.0, (4.0, 0.0, 0.0)))  # two cells forward: cell i has the content of cell i+2
    torch.testing.assert_close(warped[:, :, :-2], volume[:, :, 2:], rtol=0, atol=1e-12)
    assert (warped[:, :, -2:] == 0).all()


@pytest.mark.parametrize("grid", [CYLINDER, RING, CUBOID])
def test_a_general_pose_agrees_with_a_plain_loop(grid):
    generator = torch.Generator().manual_seed(3)
    volume = torch.randn(1, 1, *grid.shape, generator=generator, dtype=torch.float64)
    pose = turn(0.7, (1.3, -2.1, 0.4))
    warped, valid = grid.warp(volume, pose)[0, 0], grid.warp_valid(pose)[0]
    centers = grid.centers(torch.float64)
    for cell in torch.randint(0, grid.num_cells, (400,), generator=generator).tolist():
        i = tuple(int(part) for part in torch.unravel_index(torch.tensor(cell), grid.shape))
        point = (pose[0] @ torch.cat([centers[i], torch.ones(1, dtype=torch.float64)]))[:3].tolist()
        expected, inside = lookup(grid, volume[0, 0], point)
        assert bool(valid[i]) == inside
        assert warped[i].item() == pytest.approx(expected, abs=1e-9)


def lookup(grid, volume, point):
    values = point
    if isinstance(grid, Cylinder):
        values = [math.hypot(point[0], point[1]), math.atan2(point[1], point[0]), point[2]]
    total, corners, inside = 0.0, [((), 1.0)], True
    for axis, value in enumerate(values):
        low, high = grid.bounds[axis]
        cells = grid.shape[axis]
        position = (value - low) / (high - low) * cells
        inside &= grid.periodic[axis] or 0 <= position < cells
        lower = math.floor(position - 0.5)
        fraction = position - 0.5 - lower
        step = []
        for index, weight in ((lower, 1 - fraction), (lower + 1, fraction)):
            step.append((index % cells if grid.periodic[axis] else min(max(index, 0), cells - 1), weight))
        corners = [((*index, i), weight * w) for index, weight in corners for i, w in step]
    for index, weight in corners:
        total += weight * volume[index].item()
    return (total if inside else 0.0), inside


def test_samples_of_a_batch_do_not_mix():
    volume = torch.randn(2, 2, *CUBOID.shape)
    poses = torch.cat([turn(0.3, (1.0, 0.0, 0.0)), turn(-0.8)])
    both = CUBOID.warp(volume, poses)
    for i in range(2):
        assert torch.equal(both[i : i + 1], CUBOID.warp(volume[i : i + 1], poses[i : i + 1]))


def test_gradient_reaches_the_volume():
    grid = Cylinder(shape=(2, 4, 2), radius_m=(0.0, 4.0), height_m=(-1.0, 1.0))
    volume = torch.randn(1, 1, *grid.shape, dtype=torch.float64, requires_grad=True)
    pose = turn(0.4, (0.5, 0.2, 0.1))
    assert torch.autograd.gradcheck(lambda v: grid.warp(v, pose), (volume,))
