"""Lines of points, and what is at a distance along them."""

import numpy as np


def arc_lengths(points_m: np.ndarray) -> np.ndarray:
    """Return the (n,) distances of (n, D) points from the first one, along the line through them."""
    return np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])


def interpolate(at: np.ndarray, along: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Return the (..., D) points at positions (...) of a line of (n, D) points at increasing positions (n,)."""
    return np.stack([np.interp(at, along, column) for column in points_m.T], -1)
