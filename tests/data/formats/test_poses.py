import numpy as np
import pytest

from omniocc.data.formats.poses import inverse, quaternion_pose, rigid, shift, transform_points


@pytest.mark.parametrize(
    ("quaternion", "rows"),
    [
        (
            (0.6924185592174665, -0.7031619420114925, -0.11648342771943819, 0.11203317912370753),
            (
                (0.947760356, 0.008665722, -0.318865510),
                (0.318961131, -0.013976300, 0.947664740),
                (0.003755639, -0.999864775, -0.016010211),
            ),
        ),
        (
            (0.706749235646644, -0.015300993788500868, 0.01739745181256607, -0.7070846669051719),
            (
                (-0.000542795, 0.998930699, 0.046229468),
                (-0.999995492, -0.000405693, -0.002975012),
                (-0.002953075, -0.046230874, 0.998926417),
            ),
        ),
    ],
)
def test_quaternions_of_nuscenes(quaternion, rows):
    pose = quaternion_pose(quaternion, (1.0, 2.0, 3.0), "LIDAR_TOP")
    np.testing.assert_allclose(pose[:3, :3], rows, atol=1e-9)
    assert pose[:3, 3].tolist() == [1, 2, 3]
    np.testing.assert_allclose(inverse(pose) @ pose, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(
        transform_points(pose, np.array([[1.0, 0, 0]])), [np.array(rows)[:, 0] + [1, 2, 3]], atol=1e-9
    )


@pytest.mark.parametrize(
    ("quaternion", "translation"),
    [
        ((1, 0, 0), (0, 0, 0)),
        ((0.5, 0, 0, 0), (0, 0, 0)),
        ((1, 0, 0, 0), (0, 0, np.nan)),
        ((np.nan, 0, 0, 1), (0, 0, 0)),
    ],
)
def test_what_is_no_pose_is_named(quaternion, translation):
    with pytest.raises(ValueError, match=r"record 7: .* are no pose"):
        quaternion_pose(quaternion, translation, "record 7")


def test_rounded_rotations_are_mended_and_others_refused():
    exact = quaternion_pose((0.6, 0.8, 0.0, 0.0), (1, 2, 3), "")
    np.testing.assert_allclose(rigid(exact.round(4)[:3], "camera"), exact, atol=1e-4)
    turn = rigid(np.stack([exact.round(4), np.eye(4)]), "camera")[:, :3, :3]
    np.testing.assert_allclose(turn @ turn.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-12)
    for wrong in (2 * exact, np.diag([1.0, 1, -1, 1]), exact * np.nan):
        with pytest.raises(ValueError, match=r"^camera: "):
            rigid(wrong, "camera")


def test_a_shifted_frame_has_its_origin_there():
    assert (inverse(shift(1, 2, 3)) @ [1, 2, 3, 1]).tolist() == [0, 0, 0, 1]
