import pytest
import torch

from omniocc.camera.pose import angles_of, invert_pose, pose_from_angles


@pytest.mark.parametrize(
    ("yaw", "pitch", "roll", "right", "down", "forward"),
    [
        (0, 0, 0, (0, -1, 0), (0, 0, -1), (1, 0, 0)),
        (90, 0, 0, (1, 0, 0), (0, 0, -1), (0, 1, 0)),
        (180, 0, 0, (0, 1, 0), (0, 0, -1), (-1, 0, 0)),
        (0, -90, 0, (0, -1, 0), (-1, 0, 0), (0, 0, -1)),
        (0, 0, 90, (0, 0, -1), (0, 1, 0), (1, 0, 0)),
    ],
)
def test_axes_in_the_ego_frame(yaw, pitch, roll, right, down, forward):
    pose = pose_from_angles((1.0, 2.0, 3.0), float(yaw), float(pitch), float(roll))
    expected = torch.tensor([right, down, forward], dtype=torch.float64).T
    assert torch.equal(pose[:3, :3], expected)
    assert pose[:3, 3].tolist() == [1, 2, 3]


def test_order_is_roll_then_pitch_then_yaw():
    forward = pose_from_angles((0.0, 0.0, 0.0), -60.0, -10.0, 30.0)[:3, 2]
    expected = [0.984807753012208 * 0.5, -0.984807753012208 * 0.8660254037844386, -0.17364817766693033]
    torch.testing.assert_close(forward, torch.tensor(expected, dtype=torch.float64))


def test_inverse():
    pose = pose_from_angles((1.0, -2.0, 0.5), 33.0, -10.0, 4.0)
    torch.testing.assert_close(invert_pose(pose) @ pose, torch.eye(4, dtype=torch.float64), rtol=0, atol=1e-15)


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (170.0, -80.0, 20.0), (-90.0, 45.0, 180.0), (33.0, -10.0, -90.0)])
def test_angles_of_a_pose_are_those_it_was_made_of(angles):
    pose = pose_from_angles((1.0, 2.0, 3.0), *angles)
    assert angles_of(pose) == pytest.approx(angles, abs=1e-9)
    assert angles_of(pose[:3, :3]) == angles_of(pose)
