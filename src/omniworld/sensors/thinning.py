"""Thinning of a frame's surface points: within reach, and about one in each cube of 0.1 m."""

from typing import no_type_check

import numpy as np

from omniworld.mesh.label import POLE, ROADLINE
from rayiou.compiled import compiled

REACH_M = 26.0  # points farther off in x or y are not kept
HEIGHT_M = 6.0  # points farther above or below the ego origin are not kept
CUBE_M = 0.1
SCRATCH = 1 << 22  # length of the scratch array


def within_reach(points_m: np.ndarray) -> np.ndarray:
    """Return (P,) bool: whether a point (P, 3) is where a voxel grid may need it."""
    distance = np.abs(points_m)
    return (distance[:, 0] < REACH_M) & (distance[:, 1] < REACH_M) & (distance[:, 2] < HEIGHT_M)


def cubes(points_m: np.ndarray) -> np.ndarray:
    """Return (P,) int32 number of the 0.1 m cube of each point; repeats after 102.4 m, in z after 12.8 m."""
    x, y, z = np.floor(points_m.T * np.float32(1 / CUBE_M)).astype(np.int32)
    # the lowest 22 bits choose the entry of `scratch`: they differ for cubes less than 25.6 m (in z 6.4 m) apart
    near = ((x & 255) << 8 | (y & 255)) << 6 | (z & 63)
    return ((x >> 8 & 3) << 3 | (y >> 8 & 3) << 1 | (z >> 6 & 1)) << 22 | near


def first_of_each(cube: np.ndarray, labels: np.ndarray, scratch: np.ndarray) -> np.ndarray:
    """Return ascending indices of one point of each cube, preferring thin objects.

    `cube` (P,) is from `cubes`, `labels` (P,) uint8. `scratch` (SCRATCH,) int32 is overwritten; where two cubes collide
    in it, one of them keeps all its points.
    """
    kept = np.empty(len(cube), np.int64)
    return kept[: _first_of_each(cube, labels, scratch, kept)]


@compiled
@no_type_check
def _first_of_each(cube, labels, scratch, kept):
    """Fill the first elements of `kept` (P,) with the indices; return their number."""
    # Every entry that is read has been written in this call, so that nothing needs clearing; later writes win.
    for point in range(len(cube) - 1, -1, -1):
        scratch[cube[point] & (SCRATCH - 1)] = point
    for point in range(len(cube) - 1, -1, -1):
        if POLE <= labels[point] <= ROADLINE:
            scratch[cube[point] & (SCRATCH - 1)] = point
    count = 0
    for point in range(len(cube)):
        winner = scratch[cube[point] & (SCRATCH - 1)]
        if winner == point or cube[winner] != cube[point]:
            kept[count] = point
            count += 1
    return count
