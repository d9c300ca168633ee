"""Poses as the tables of public datasets hold them."""

from collections.abc import Iterator, Sequence

import numpy as np

TOLERANCE = 1e-3
"""Largest error of a rotation that is taken for rounding, and mended."""
FARTHEST_M = 1e8
"""Largest coordinate of a position, in absolute value: no frame of a map, not even of the Earth's middle, has more."""
RIGID_TOLERANCE = 1e-6
"""Largest error of the poses of a source."""
SHORTEST_STEP_S = 1e-6
"""Time between two frames below which it is taken as this long."""


def quaternion_pose(rotation: Sequence[float], translation_m: Sequence[float], name: str) -> np.ndarray:
    """Return `a_from_b`, (4, 4) float64, of a unit quaternion w, x, y, z and a position.

    Raises:
        ValueError: beginning with `name`, if the quaternion has another length or a value is not finite.
    """
    q, t = np.asarray(rotation, np.float64), np.asarray(translation_m, np.float64)
    length = float(np.linalg.norm(q))
    if q.shape != (4,) or t.shape != (3,) or not np.isfinite(t).all() or not abs(length - 1) < TOLERANCE:
        finite = np.isfinite(q).all() and np.isfinite(t).all()
        reason = f"the quaternion's length is {length:.4g}, it must be 1" if finite else "a number is not finite"
        raise ValueError(f"{name}: rotation {list(rotation)}, translation {list(translation_m)} are no pose ({reason})")
    check_position(t, name)
    w, x, y, z = q / length
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = t
    return pose


def is_euroc(values: Sequence[float]) -> bool:
    """Return whether 16 numbers are EuRoC's: position, quaternion w, x, y, z, velocity, biases; not a 4x4 matrix."""
    unit = abs(float(np.linalg.norm(values[3:7])) - 1) < TOLERANCE
    return len(values) == 16 and unit and list(values[12:]) != [0, 0, 0, 1]


def check_position(position_m: np.ndarray, name: str) -> None:
    """Raise ValueError beginning with `name` if a finite position, (..., 3), is nowhere on Earth."""
    if (farthest_m := float(np.abs(position_m).max(initial=0))) > FARTHEST_M:
        raise ValueError(f"{name}: its position is {farthest_m:.3g} m away; positions are in m, at most {FARTHEST_M:g}")


def rigid(matrix: np.ndarray, name: str) -> np.ndarray:
    """Return poses (..., 3 or 4, 4) as (..., 4, 4) float64 with exact rotations: files round them to a few digits.

    Raises:
        ValueError: beginning with `name`, if a 3x3 part is farther from a rotation than rounding makes it.
    """
    given = np.asarray(matrix, np.float64)
    if not np.isfinite(given).all():
        raise ValueError(f"{name}: a value of the pose is not finite")
    check_position(given[..., :3, 3], name)
    left, _, right = np.linalg.svd(given[..., :3, :3])
    nearest = left @ right
    error = float(np.abs(nearest - given[..., :3, :3]).max(initial=0))
    if error > TOLERANCE or (np.linalg.det(nearest) < 0).any():
        raise ValueError(f"{name}: the 3x3 part of the pose is no rotation (it is off by {error:.3g})")
    pose = np.zeros((*given.shape[:-2], 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = nearest, given[..., :3, 3], 1
    return pose


def not_rigid(poses: np.ndarray) -> np.ndarray:
    """Return which poses (F, 4, 4) are no rotation and shift, to 1e-6; (F,) bool."""
    turn = poses[:, :3, :3]
    last_row = np.abs(poses[:, 3] - (0, 0, 0, 1)).max(axis=1)
    bent = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) + last_row
    return ~((bent < RIGID_TOLERANCE) & (np.linalg.det(turn) > 0))


def jumps(
    poses: np.ndarray, time_s: np.ndarray, max_speed_mps: float, max_turn_deg_per_s: float
) -> Iterator[tuple[int, str]]:
    """Yield the first frame that a car cannot have reached from the one before, by speed and by turn, and why.

    Args:
        poses: world_from_ego (F, 4, 4), rotations and shifts.
        time_s: of the frames, (F,).
        max_speed_mps: largest speed.
        max_turn_deg_per_s: largest speed of turning.
    """
    turn = poses[:, :3, :3]
    steps_s = np.maximum(np.diff(time_s), SHORTEST_STEP_S)
    speed_mps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / steps_s
    between = turn[:-1].transpose(0, 2, 1) @ turn[1:]
    cosine = np.clip((np.trace(between, axis1=1, axis2=2) - 1) / 2, -1, 1)
    turn_deg_per_s = np.degrees(np.arccos(cosine)) / steps_s
    limits = (speed_mps, max_speed_mps, "m/s"), (turn_deg_per_s, max_turn_deg_per_s, "degrees/s")
    for values, limit, unit in limits:
        far = np.flatnonzero(~(values <= limit))  # nan is an error too
        if len(far):
            yield int(far[0]) + 1, f"its pose jumps: {values[far[0]]:.0f} {unit} since the frame before"


def inverse(a_from_b: np.ndarray) -> np.ndarray:
    """Return `b_from_a`, (..., 4, 4), of rigid poses."""
    turned = a_from_b[..., :3, :3].swapaxes(-1, -2)
    pose = np.zeros_like(a_from_b)
    pose[..., :3, :3], pose[..., 3, 3] = turned, 1
    pose[..., :3, 3] = -np.einsum("...ij,...j->...i", turned, a_from_b[..., :3, 3])
    return pose


def shift(x_m: float, y_m: float, z_m: float) -> np.ndarray:
    """Return the pose of a frame with parallel axes whose origin is there, (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = x_m, y_m, z_m
    return pose


def transform_points(a_from_b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points (P, 3) of b in a, in float64."""
    return points.astype(np.float64) @ a_from_b[:3, :3].T + a_from_b[:3, 3]
