"""Camera poses from a position and three angles, and operations on rigid poses."""

import math

import torch
from jaxtyping import Float, Float64
from torch import Tensor

# Columns: the directions of a camera's right, down and forward in the ego frame when all angles are 0.
LEVEL_FORWARD = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))


def pose_from_angles(
    position_m: tuple[float, float, float], yaw_deg: float, pitch_deg: float, roll_deg: float
) -> Float64[Tensor, "4 4"]:
    """Return `ego_from_camera` of a camera at `position_m` in the ego frame.

    With all angles 0 the camera faces forward, upright. It is rolled, then pitched, then yawed: `yaw_deg`
    counter-clockwise seen from above (90 is left), `pitch_deg` upwards (-10 is towards the road), `roll_deg` clockwise
    seen from behind.
    """
    cy, sy = _cos_sin(yaw_deg)
    cp, sp = _cos_sin(-pitch_deg)
    cr, sr = _cos_sin(roll_deg)
    yaw = torch.tensor([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]], dtype=torch.float64)
    pitch = torch.tensor([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]], dtype=torch.float64)
    roll = torch.tensor([[1, 0, 0], [0, cr, -sr], [0, sr, cr]], dtype=torch.float64)
    rotation = yaw @ pitch @ roll @ torch.tensor(LEVEL_FORWARD, dtype=torch.float64)
    pose = rigid_pose(rotation, torch.tensor(position_m, dtype=torch.float64))
    return pose + 0.0  # turns -0.0 into 0.0, so that equal poses have equal bytes


def angles_of(ego_from_camera: Float64[Tensor, "*rows columns"]) -> tuple[float, float, float]:
    """Return yaw, pitch and roll of a pose or a rotation, degrees, from which `pose_from_angles` makes it again.

    Of a camera that looks straight up or down, only the difference or the sum of yaw and roll is defined.
    """
    right, forward = ego_from_camera[:3, 0], ego_from_camera[:3, 2]
    yaw_deg = math.degrees(math.atan2(forward[1], forward[0]))
    pitch_deg = math.degrees(math.asin(min(1.0, max(-1.0, float(forward[2])))))
    upright = pose_from_angles((0.0, 0.0, 0.0), yaw_deg, pitch_deg, 0.0)[:3]
    return yaw_deg, pitch_deg, math.degrees(math.atan2(right @ upright[:, 1], right @ upright[:, 0]))


def rigid_pose(rotation: Float64[Tensor, "3 3"], position: Float[Tensor, "3"]) -> Float64[Tensor, "4 4"]:
    """Return `a_from_b` of the rotation of b's axes into a, and of the position of b's origin in a, m."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def invert_pose(a_from_b: Float64[Tensor, "*batch 4 4"]) -> Float64[Tensor, "*batch 4 4"]:
    """Return `b_from_a` of rigid poses."""
    rotation = a_from_b[..., :3, :3].transpose(-1, -2)
    inverse = torch.zeros_like(a_from_b)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3:] = -rotation @ a_from_b[..., :3, 3:]
    inverse[..., 3, 3] = 1
    return inverse


def check_rigid(pose: Float64[Tensor, "4 4"], name: str) -> None:
    """Raise ValueError, beginning with `name`, unless the pose is a rotation and a translation, to 1e-6."""
    if not bool(pose.isfinite().all()):
        raise ValueError(f"{name}: ego_from_camera holds a value that is not finite: {pose.tolist()}")
    if pose[3].tolist() != [0, 0, 0, 1]:
        raise ValueError(f"{name}: the last row of ego_from_camera is {pose[3].tolist()}; it must be [0, 0, 0, 1]")
    rotation = pose[:3, :3]
    error = float((rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max())
    determinant = float(torch.linalg.det(rotation))
    if error > 1e-6 or determinant < 0:
        raise ValueError(
            f"{name}: ego_from_camera is not rigid: its 3x3 part R has |R R^T - 1| = {error:.3g} and determinant "
            f"{determinant:.6g}; R must be a rotation (columns: the camera's right, down and forward in the ego frame)"
        )


def check_road(road_z_m: float | None) -> None:
    """Raise ValueError unless the road's height in the frame of a rig is between -100 m and 0, or None: not known."""
    if road_z_m is not None and not -100 < road_z_m < 0:
        raise ValueError(f"road_z_m is {road_z_m}; it must be between -100 and 0, in metres: the road is below the rig")


def _cos_sin(angle_deg: float) -> tuple[float, float]:
    """Return cosine and sine, exact at multiples of 90 degrees."""
    quarter = angle_deg / 90
    if quarter == round(quarter):
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter) % 4]
    return math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
