import math

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.temporal import Mean

CUBOID = Cuboid((12, 10, 4), (-12.0, 12.0), (-10.0, 10.0), (-2.0, 2.0))  # cells of 2 x 2 x 1 m
CYLINDER = Cylinder((6, 20, 4), (0.0, 12.0), (-2.0, 2.0))
TURN_RAD = 2 * math.pi / 20


def pose(x_m=0.0, y_m=0.0, z_m=0.0, yaw_rad=0.0):
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:2, :2] = torch.tensor([[math.cos(yaw_rad), -math.sin(yaw_rad)], [math.sin(yaw_rad), math.cos(yaw_rad)]])
    matrix[:3, 3] = torch.tensor([x_m, y_m, z_m])
    return matrix


def sequence(*poses):
    return torch.stack(poses)[None]


def volumes_at(grid, field, poses):
    """Return a static world on the grid at each pose: the field at every cell's centre."""
    centers = torch.cat([grid.centers(torch.float64), torch.ones(*grid.shape, 1, dtype=torch.float64)], dim=-1)
    return [field((centers @ at.T)[..., :3]).movedim(-1, 0)[None] for at in poses[0]]


def labels_on_a_lattice(points):
    """Random classes in world cells of 2 x 2 x 1 m, as one-hot features."""
    table = torch.randint(0, 5, (64, 64, 64), generator=torch.Generator().manual_seed(7))
    x, y, z = (points / torch.tensor([2.0, 2.0, 1.0])).floor().long().unbind(-1)
    return torch.nn.functional.one_hot(table[x % 64, y % 64, z % 64], 5).double()


def labels_in_sectors(points):
    """Random classes by world azimuth, distance and height, as one-hot features."""
    table = torch.randint(0, 5, (6, 20, 4), generator=torch.Generator().manual_seed(8))
    x, y, z = points.unbind(-1)
    sector = (torch.atan2(y, x) / TURN_RAD + 10).floor().long() % 20
    return torch.nn.functional.one_hot(table[(torch.hypot(x, y) / 2).long(), sector, (z + 2).long()], 5).double()


def waves(points):
    return torch.stack([(0.25 * points).sum(-1).sin(), (points[..., 0] * 0.3 - points[..., 1] * 0.2).cos()], dim=-1)


DRIVES = {
    "cuboid": (CUBOID, labels_on_a_lattice, sequence(pose(34, 8), pose(36, 8), pose(38, 6, 1), pose(40, 2, 1))),
    "cuboid turning": (CUBOID, labels_on_a_lattice, sequence(pose(4, 2), pose(4, 4, yaw_rad=math.pi / 2), pose(2, 4))),
    "cylinder": (CYLINDER, labels_in_sectors, sequence(*(pose(yaw_rad=k * TURN_RAD) for k in (19, 0, 3, 8)))),
}


@pytest.mark.parametrize("name", list(DRIVES))
def test_a_static_scene_aligns_exactly_and_with_the_wrong_sign_it_does_not(name):
    grid, field, poses = DRIVES[name]
    volumes = volumes_at(grid, field, poses)
    everywhere = torch.ones(poses.shape[:2], dtype=torch.bool)
    fused = Mean(grid, poses.shape[1], False)(volumes, poses, everywhere)
    torch.testing.assert_close(fused, volumes[-1], rtol=0, atol=1e-9)
    wrong = Mean(grid, poses.shape[1], False)(volumes, torch.linalg.inv(poses), everywhere)
    assert (wrong.argmax(1) != volumes[-1].argmax(1)).double().mean() > 0.2


@pytest.mark.parametrize("kind", ["cuboid", "cylinder"])
def test_between_cells_the_error_is_that_of_interpolation(kind):
    poses = sequence(pose(31.3, -8.2, 0.1, 0.5), pose(33.1, -7.4, 0.0, 0.7), pose(34.2, -5.9, -0.1, 1.0))
    errors = []
    for scale in (1, 2, 4):
        if kind == "cuboid":
            grid = Cuboid((24 * scale, 20 * scale, 8 * scale), (-12.0, 12.0), (-10.0, 10.0), (-2.0, 2.0))
        else:
            grid = Cylinder((12 * scale, 40 * scale, 8 * scale), (2.0, 14.0), (-2.0, 2.0))
        volumes = volumes_at(grid, waves, poses)
        fused = Mean(grid, 3, False)(volumes, poses, torch.ones(1, 3, dtype=torch.bool))
        errors.append((fused - volumes[-1]).abs().mean().item())
        wrong = Mean(grid, 3, False)(volumes, torch.linalg.inv(poses), torch.ones(1, 3, dtype=torch.bool))
    # second order inside, first order in the half cells at the border
    assert errors[0] / errors[2] > 8
    assert errors[2] < 0.003
    assert (wrong - volumes[-1]).abs().mean() > 0.2


@pytest.mark.parametrize("grid", [CUBOID, CYLINDER])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_volumes_of_a_standing_car_are_averaged_exactly(grid, dtype):
    volume = torch.randn(2, 3, *grid.shape).to(dtype)
    poses = pose(211.7, -35.3, 4.1, 0.77).expand(2, 4, 4, 4)
    fused = Mean(grid, 4, False)([volume] * 4, poses, torch.ones(2, 4, dtype=torch.bool))
    assert torch.equal(fused, volume)


def test_the_mean_is_over_frames_whose_grid_holds_the_cell():
    # 4 m forward per frame: two cells of the past frame's front are new, then four
    poses = sequence(pose(0), pose(4), pose(8))
    volumes = [torch.full((1, 1, *CUBOID.shape), value) for value in (1.0, 4.0, 10.0)]
    fused = Mean(CUBOID, 3, False)(volumes, poses, torch.ones(1, 3, dtype=torch.bool))
    expected = torch.tensor([5.0] * 8 + [7.0] * 2 + [10.0] * 2)
    assert torch.equal(fused, expected.view(1, 1, 12, 1, 1).expand_as(fused))


def test_missing_frames_are_ignored():
    torch.manual_seed(0)
    poses = sequence(pose(0), pose(1, 0.5), pose(2, yaw_rad=0.2)).repeat(2, 1, 1, 1)
    volumes = [torch.randn(2, 3, *CYLINDER.shape) for _ in range(3)]
    exists = torch.tensor([[False, True, True], [True, True, True]])
    volumes[0][0] = 1e6
    fused = Mean(CYLINDER, 3, False)(volumes, poses, exists)
    shorter = Mean(CYLINDER, 2, False)([v[:1] for v in volumes[1:]], poses[:1, 1:], exists[:1, 1:])
    assert torch.equal(fused[:1], shorter)
    whole = Mean(CYLINDER, 3, False)([v[1:] for v in volumes], poses[1:], exists[1:])
    assert torch.equal(fused[1:], whole)
    single = Mean(CYLINDER, 3, False)(volumes, poses, torch.tensor([[False, False, True]] * 2))
    assert torch.equal(single, volumes[-1])


def test_a_window_without_past_frames_is_an_error():
    with pytest.raises(ValueError, match="frames is 1"):
        Mean(CUBOID, 1, False)


def test_turning_the_ego_frame_rolls_the_mean():
    poses = sequence(pose(0.0, 0.0), pose(1.3, 0.4, yaw_rad=0.2), pose(2.5, 1.1, 0.2, yaw_rad=0.5))
    torch.manual_seed(0)
    volumes = list(torch.randn(3, 1, 2, *CYLINDER.shape))
    mean = Mean(CYLINDER, 3, history_gradient=False)
    exists = torch.ones(1, 3, dtype=torch.bool)
    turned_from_ego = pose(yaw_rad=3 * TURN_RAD)
    rolled = mean([volume.roll(3, dims=3) for volume in volumes], poses @ turned_from_ego.inverse(), exists)
    straight = mean(volumes, poses, exists)
    assert not torch.allclose(rolled, straight, atol=1e-3)
    torch.testing.assert_close(rolled, straight.roll(3, dims=3), atol=1e-5, rtol=0)


def test_gradient_reaches_past_and_newest_but_not_missing_frames():
    poses = sequence(pose(0), pose(0.7, 0.3, yaw_rad=0.1), pose(1.9, yaw_rad=0.3))
    small = Cylinder((2, 4, 2), (0.0, 4.0), (-1.0, 1.0))
    torch.manual_seed(0)
    volumes = [torch.randn(1, 1, *small.shape, dtype=torch.float64, requires_grad=True) for _ in range(3)]
    mean, exists = Mean(small, 3, history_gradient=True), torch.tensor([[False, True, True]])
    assert torch.autograd.gradcheck(lambda *v: mean(list(v), poses, exists), tuple(volumes))
    fused = mean(volumes, poses, exists)
    missing, past = torch.autograd.grad(fused.sum(), volumes[:2], allow_unused=True)
    assert missing is None
    assert past.abs().sum() > 0
