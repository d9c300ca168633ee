"""Thinning of a frame's surface points: within reach, and about one in each cube of 0.1 m."""

import numpy as np

from omniocc.world.mesh.label import POLE, ROADLINE

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
    near = ((x & 255) << 8 | (y & 255)) << 6 | (z & 63)
    return ((x >> 8 & 3) << 3 | (y >> 8 & 3) << 1 | (z >> 6 & 1)) << 22 | near


def first_of_each(cube: np.ndarray, labels: np.ndarray, scratch: np.ndarray) -> np.ndarray:
    """Return ascending indices of one point of each cube, preferring thin objects.

    `cube` (P,) is from `cubes`, `labels` (P,) uint8. `scratch` (SCRATCH,) int32 is overwritten; where two cubes collide
    in it, one of them keeps all its points.
    """
    number = np.arange(len(cube), dtype=np.int32)
    place = cube & (SCRATCH - 1)
    # Every entry that is read has been written in this call, so that nothing needs clearing; later writes win.
    scratch[place[::-1]] = number[::-1]
    thin = np.flatnonzero((labels >= POLE) & (labels <= ROADLINE))[::-1]
    scratch[place[thin]] = number[thin]
    winner = scratch[place]
    return np.flatnonzero((winner == number) | (cube[winner] != cube))
