"""Streams of time stamps: which sample of each belongs to a frame, and poses between the stamps."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial.transform import Rotation

from omniocc.data.formats.poses import inverse

MISSING = -1


def nearest(
    times_s: Float64[np.ndarray, " S"], at_s: Float64[np.ndarray, " F"], limit_s: float
) -> Int64[np.ndarray, " F"]:
    """Return the number of the sample that is nearest in time to each of `at_s`; -1 if it is farther than `limit_s`.

    `times_s` increase; of two that are equally near, the earlier one is taken.
    """
    if not len(times_s):
        return np.full(len(at_s), MISSING, np.int64)
    after = np.searchsorted(times_s, at_s).clip(0, len(times_s) - 1)
    before = np.maximum(after - 1, 0)
    found = np.where(np.abs(times_s[before] - at_s) <= np.abs(times_s[after] - at_s), before, after)
    return np.where(np.abs(times_s[found] - at_s) <= limit_s, found, MISSING).astype(np.int64)


def gap_s(times_s: Float64[np.ndarray, " S"], at_s: Float64[np.ndarray, " F"]) -> float:
    """Return the smallest difference between any of the two kinds of time stamps, s; inf if there are none."""
    found = nearest(times_s, at_s, np.inf)
    return float(np.abs(times_s[found] - at_s).min(initial=np.inf)) if len(times_s) else np.inf


def paced(times_s: Float64[np.ndarray, " S"], interval_s: float | None) -> Int64[np.ndarray, " F"]:
    """Return the samples that are nearest to every multiple of an interval after the first; all of them with None.

    Multiples in gaps of the stream, without a sample within half the interval, have none, nor have those after its end.
    """
    if interval_s is None or len(times_s) < 2:
        return np.arange(len(times_s))
    late_s = np.median(np.diff(times_s)) / 2  # of the last sample, whose time may differ a little
    count = int((times_s[-1] - times_s[0] + late_s) / interval_s) + 1
    found = nearest(times_s, times_s[0] + interval_s * np.arange(count), interval_s / 2)
    return np.unique(found[found != MISSING])


def lacking(matches: Mapping[str, Int64[np.ndarray, " F"]]) -> list[list[str]]:
    """Return for every frame the names of the streams that have no sample near enough."""
    columns = {name: found == MISSING for name, found in matches.items()}
    frames = len(next(iter(columns.values()))) if columns else 0
    return [[name for name, missing in columns.items() if missing[frame]] for frame in range(frames)]


def interpolate(
    times_s: Float64[np.ndarray, " P"],
    poses: Float64[np.ndarray, "P 4 4"],
    at_s: Float64[np.ndarray, " F"],
    limit_s: float,
    most_s: float = np.inf,
) -> tuple[Float64[np.ndarray, "F 4 4"], Bool[np.ndarray, " F"]]:
    """Return poses at other times: positions on straight lines, rotations about fixed axes (slerp), at constant speed.

    Args:
        times_s: of the poses, increasing.
        poses: a_from_b at these times.
        at_s: times that are asked for.
        limit_s: time before the first pose and after the last up to which the motion beside is continued.
        most_s: longest time between two poses that are interpolated.

    Returns:
        The poses, and which of them are known: the others are beyond the limit or in a gap, and the identity.
    """
    known = (at_s >= times_s[0] - limit_s) & (at_s <= times_s[-1] + limit_s) if len(times_s) else np.zeros(len(at_s))
    known = np.asarray(known, bool)
    result = np.broadcast_to(np.eye(4), (len(at_s), 4, 4)).copy()
    if not known.any():
        return result, known
    if len(times_s) == 1:
        result[known] = poses[0]
        return result, known
    first = (np.searchsorted(times_s, at_s, side="right") - 1).clip(0, len(times_s) - 2)
    step_s = times_s[first + 1] - times_s[first]
    part = (at_s - times_s[first]) / step_s  # below 0 and above 1 where the motion is continued beyond the ends
    on_stamp = (part == 0) | (part == 1)
    known &= (step_s <= most_s) | on_stamp
    turn = Rotation.from_matrix((inverse(poses[first]) @ poses[first + 1])[:, :3, :3]).as_rotvec()
    moved = poses[first].copy()
    moved[:, :3, :3] = poses[first, :3, :3] @ Rotation.from_rotvec(part[:, None] * turn).as_matrix()
    moved[:, :3, 3] += part[:, None] * (poses[first + 1, :3, 3] - poses[first, :3, 3])
    moved[part == 0], moved[part == 1] = poses[first[part == 0]], poses[first[part == 1] + 1]  # to the last bit
    result[known] = moved[known]
    return result, known
