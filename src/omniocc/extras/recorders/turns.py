"""The turn of a LiDAR: the times of its points, and the points where the car was at one time."""

import numpy as np
from jaxtyping import Float32, Float64

from omniocc.data.formats.poses import inverse
from omniocc.errors import DataError
from omniocc.extras.recorders.poses import PER_SECOND
from omniocc.extras.recorders.streams import interpolate

SHORTEST_S, LONGEST_S = 2e-3, 1.0
"""Limits of the time that the points of a scan span, and of the time between them and the stamp of the scan."""
OPEN_S = 2 * LONGEST_S
"""At stamps up to this, times after the stamp and by the clock may both fit."""
TICK_S = 2.5e-4
"""Points within this time have one pose: at 30 m/s the car moves 8 mm."""


def seconds_of(
    times: np.ndarray, scan_s: float, where: str, after: bool | None = None
) -> Float64[np.ndarray, " P"] | None:
    """Return the times of the points of a scan by the clock of its stamp, s; None if all are equal.

    Drivers write them after the stamp of the scan or by the clock, in s, ms, us or ns: with limits that are less than
    1,000 apart, only one unit fits.

    Args:
        times: (P,) of the points, of any type of numbers.
        scan_s: stamp of the scan.
        where: file or message, for errors.
        after: whether they are after the stamp (`are_after`); None: what fits better.

    Raises:
        DataError: if no unit fits.
    """
    if not len(times) or (times == times[0]).all():
        return None
    if (found := _fitting(times, scan_s, after)) is not None:
        return found[0]
    raise DataError(
        f"{where}: the times of its points, {times.min()} to {times.max()}, are not those of a turn at {scan_s:.6f} s "
        "in s, ms, us or ns; lidar.deskew=false reads the points without them"
    )


def are_after(times: np.ndarray | None, scan_s: float) -> bool | None:
    """Return whether the times of a scan are after its stamp, not by the clock; None if they do not tell.

    Where the clock of a log begins at 0, only late scans can tell: at the stamp .1 s, .05 s may be either.
    """
    found = None if times is None or not len(times) else _fitting(times, scan_s, None)
    return None if found is None else found[1]


def _fitting(times: np.ndarray, scan_s: float, after: bool | None) -> tuple[Float64[np.ndarray, " P"], bool] | None:
    """Return the times by the clock, s, in the first unit that fits, and whether they are after the stamp."""
    for per_second in PER_SECOND.values():
        found_s = times.astype(np.float64) / per_second
        middle_s = np.median(found_s)
        late = bool(abs(middle_s) < abs(middle_s - scan_s)) if after is None else after
        found_s = found_s + scan_s if late else found_s
        if np.ptp(found_s) >= SHORTEST_S and np.abs(found_s - scan_s).max() <= LONGEST_S:
            return found_s, late
    return None


def at_one_time(
    points_m: Float32[np.ndarray, "P 3"],
    times_s: Float64[np.ndarray, " P"],
    pose_times_s: Float64[np.ndarray, " N"],
    world_from_ego: Float64[np.ndarray, "N 4 4"],
    world_from_frame: Float64[np.ndarray, "4 4"],
) -> Float32[np.ndarray, "P 3"]:
    """Return points, each measured in the ego frame of its own time, in the ego frame of one time.

    Args:
        points_m: in the ego frames, m.
        times_s: of the points.
        pose_times_s: of the poses of the car; before the first and after the last one the motion goes on.
        world_from_ego: these poses.
        world_from_frame: the pose at the one time.
    """
    ticks, place = np.unique(np.round(times_s / TICK_S), return_inverse=True)
    there, _ = interpolate(pose_times_s, world_from_ego, ticks * TICK_S, np.inf)
    pose = (inverse(world_from_frame) @ there)[place]
    return (np.einsum("pij,pj->pi", pose[:, :3, :3], points_m) + pose[:, :3, 3]).astype(np.float32)
