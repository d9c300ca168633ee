import math

import numpy as np
import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.metric import sparseocc_origins, trajectory_origins


def test_eight_evenly_spaced_positions_are_taken():
    positions = torch.zeros(20, 3)
    positions[:, 0] = torch.arange(20) - 9.0
    # round(linspace(0, 19, 8)) = 0, 2.7, 5.4, 8.1, 10.9, 13.6, 16.3, 19
    assert (sparseocc_origins(positions)[:, 0] + 9).tolist() == [0, 3, 5, 8, 11, 14, 16, 19]


def test_few_positions_are_kept_and_far_ones_dropped():
    positions = torch.tensor(
        [[38.9, 0.0, 0.0], [39.0, 0.0, 0.0], [-39.0, 0.0, 0.0], [0.0, -38.0, 500.0], [0.0, 40.0, 0.0], [1.0, 1.0, 1.0]]
    )
    assert sparseocc_origins(positions).tolist() == positions[[0, 3, 5]].tolist()
    assert len(sparseocc_origins(torch.zeros(8, 3))) == 8  # those of a standing car are all kept
    assert sparseocc_origins(torch.full((4, 3), 50.0)).shape == (0, 3)


OCC3D = Cuboid((200, 200, 16), (-40.0, 40.0), (-40.0, 40.0), (-1.0, 5.4))
"""In the ego frame of nuScenes."""


def drive(frames, step_m, seed=0):
    """Return poses of a car that turns and climbs, far from the world's origin."""
    rng, poses, heading = np.random.default_rng(seed), [], 0.3
    place = np.array([1234.5, -987.6, 12.3])
    for _ in range(frames):
        c, s = math.cos(heading), math.sin(heading)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = [[c, -s, 0], [s, c, 0], [0, 0, 1]], place
        poses.append(pose)
        place = place + pose[:3, :3] @ np.array([step_m, 0.0, rng.normal() * 0.1])
        heading += rng.normal() * 0.05
    return np.stack(poses)


def public_rule(world_from_ego, world_from_sensor, frame, inside):
    """Return origins and times by a plain loop in float64: SparseOcc's rule, section 1.2 of its protocol."""
    kept = []
    for other in range(len(world_from_ego)):
        world = [float(world_from_sensor[other][i][3]) for i in range(3)]
        moved = [world[i] - float(world_from_ego[frame][i][3]) for i in range(3)]
        ego = [sum(float(world_from_ego[frame][i][j]) * moved[i] for i in range(3)) for j in range(3)]
        if inside(ego[0], ego[1]):
            kept.append((ego, other - frame))
    if len(kept) <= 8:
        return kept
    return [kept[round(k * (len(kept) - 1) / 7)] for k in range(8)]


@pytest.mark.parametrize(
    ("grid", "inside"),
    [
        (OCC3D, lambda x, y: abs(x) < 39 and abs(y) < 39),
        (Cylinder(), lambda x, y: math.hypot(x, y) < 24.6),
        (Cuboid(), lambda x, y: abs(x) < 24.6 and abs(y) < 24.6),
    ],
)
@pytest.mark.parametrize(("step_m", "frames"), [(2.0, 41), (0.0, 12), (11.0, 9)])
def test_origins_of_a_trajectory_are_those_of_a_plain_loop(grid, inside, step_m, frames):
    world_from_ego = drive(frames, step_m)
    mount = np.eye(4)
    mount[:3, 3] = 0.985793, 0.0, 1.84019
    for frame in (0, frames // 2, frames - 1):
        for sensor in (None, mount, np.stack([mount] * frames)):
            world_from_sensor = world_from_ego if sensor is None else world_from_ego @ sensor
            expected = public_rule(world_from_ego, world_from_sensor, frame, inside)
            found = trajectory_origins(world_from_ego, frame, grid, sensor)
            assert found.times.tolist() == [time for _, time in expected]
            np.testing.assert_allclose(found.positions_m, [place for place, _ in expected], rtol=0, atol=1e-9)
            assert len(found.times) <= 8


def test_origins_of_a_trajectory_agree_with_the_public_positions():
    world_from_ego = drive(40, 1.5)
    positions_m = torch.tensor(
        [place for place, _ in public_rule(world_from_ego, world_from_ego, 7, lambda x, y: True)]
    )
    assert len(positions_m) == 8
    every = (torch.from_numpy(world_from_ego[:, :3, 3]) - torch.from_numpy(world_from_ego[7, :3, 3])).double()
    every = every @ torch.from_numpy(world_from_ego[7, :3, :3])
    torch.testing.assert_close(trajectory_origins(world_from_ego, 7, OCC3D).positions_m, sparseocc_origins(every))


def test_the_frame_itself_is_among_the_choice_in_a_grid_that_lies_ahead():
    ahead = Cuboid((8, 8, 4), (0.0, 51.2), (-25.6, 25.6), (-2.0, 4.4))
    poses = torch.eye(4, dtype=torch.float64).repeat(4, 1, 1)
    poses[:, 0, 3] = torch.arange(4) * 5.0
    found = trajectory_origins(poses, 1, ahead)
    assert found.times.tolist() == [0, 1, 2]
    assert found.positions_m[:, 0].tolist() == [0.0, 5.0, 10.0]


def test_error_names_wrong_poses():
    poses = torch.eye(4).repeat(3, 1, 1)
    for frame, given in ((3, poses), (-1, poses), (0, poses[:, :3])):
        with pytest.raises(ValueError, match=f"frame {frame} of poses"):
            trajectory_origins(given, frame, Cylinder())
    with pytest.raises(ValueError, match=r"ego_from_sensor must have shape \(3, 4, 4\), got \(2, 4, 4\)"):
        trajectory_origins(poses, 0, Cylinder(), poses[:2])
