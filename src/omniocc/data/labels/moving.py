"""LiDAR rays that hit things that move."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from omniocc.frame import Box

MOVES_MPS = 0.3
"""Speed from which an actor moves; a car at a red light does not."""
MARGIN_M = 0.3
"""Distance by which a hit may lie outside the upright box of an actor, since the road and the ego car tilt."""


def hits_of_moving(
    range_m: Float32[np.ndarray, " R"],
    labels: UInt8[np.ndarray, " R"],
    directions: Float32[np.ndarray, "R 3"],
    boxes: Sequence[Box],
) -> Bool[np.ndarray, " R"]:
    """Return which rays hit an actor that moves: they end in its box, seen from above, on its class.

    Args:
        range_m: along the rays from the ego origin, m; inf where nothing is hit.
        labels: class that is hit.
        directions: unit rays in the ego frame.
        boxes: actors of the frame, moving or not, ego frame.
    """
    found = np.zeros(len(labels), dtype=bool)
    for box in boxes:
        if np.hypot(*box.velocity_mps) < MOVES_MPS:
            continue
        rays = np.flatnonzero(labels == box.label)
        away_m = range_m[rays, None] * directions[rays, :2] - np.array(box.center_m[:2])
        cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
        along_m = np.abs(away_m @ np.array([[cos, -sin], [sin, cos]]))
        found[rays[(along_m < np.array(box.size_m[:2]) / 2 + MARGIN_M).all(axis=1)]] = True
    return found
