"""Poses between Unreal's left-handed frames (x forward, y right, z up) and ours (x forward, y left, z up).

Conventions: https://carla.readthedocs.io/en/0.9.16/python_api/#carla.Rotation and `carla.Transform.get_matrix`.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
SENSOR_FROM_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From a camera's optical frame (x right, y down, z forward) to the right-handed frame of its sensor (x forward)."""


class UnrealPose(NamedTuple):
    """The numbers of a `carla.Transform`: m, and degrees (pitch up, yaw clockwise from above, roll to the right)."""

    x: float
    y: float
    z: float
    pitch: float
    yaw: float
    roll: float


def right_handed(matrix: Float[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
    """Return a pose in our frames of a matrix in Unreal's (`carla.Transform.get_matrix`); its own inverse."""
    return MIRROR @ np.asarray(matrix, dtype=np.float64) @ MIRROR


def right_handed_points(points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
    """Return points or velocities of an Unreal frame in ours: y changes its sign."""
    return points * np.array([1, -1, 1], dtype=points.dtype)


def pose_of(given: UnrealPose) -> Float64[np.ndarray, "4 4"]:
    """Return the pose in our frames of an Unreal pose: Rz(-yaw) Ry(-pitch) Rx(roll)."""
    pitch, yaw, roll = (math.radians(value) for value in (-given.pitch, -given.yaw, given.roll))
    z = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    y = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
    x = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = z @ y @ x, (given.x, -given.y, given.z)
    return pose


def unreal_pose(pose: Float64[np.ndarray, "4 4"]) -> UnrealPose:
    """Return the Unreal pose of a pose in our frames; the inverse of `pose_of`. Looking straight up, roll is 0."""
    turn = pose[:3, :3]
    pitch = math.asin(min(1.0, max(-1.0, turn[2, 0])))
    if abs(turn[2, 0]) > 1 - 1e-9:
        yaw, roll = math.atan2(turn[0, 1], turn[1, 1]), 0.0
    else:
        yaw, roll = -math.atan2(turn[1, 0], turn[0, 0]), math.atan2(turn[2, 1], turn[2, 2])
    x, y, z = (float(value) for value in pose[:3, 3])
    return UnrealPose(x, -y, z, math.degrees(pitch), math.degrees(yaw), math.degrees(roll))
