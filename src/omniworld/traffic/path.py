"""Paths of vehicles and people."""

from dataclasses import dataclass

import numpy as np

from omniworld.town.line import arc_lengths, interpolate

STEP_M = 0.5  # distance of a path's points
_ROUNDING = np.hanning(15)[1:-1] / np.hanning(15).sum()  # over 7 m


@dataclass(frozen=True)
class Path:
    """A path: (n, 3) points at (n,) arc lengths."""

    points_m: np.ndarray
    along_m: np.ndarray

    @property
    def length_m(self) -> float:
        """Return the length of the whole path."""
        return float(self.along_m[-1])

    def at(self, along_m: np.ndarray) -> np.ndarray:
        """Return (..., 3) positions at arc lengths."""
        return interpolate(along_m, self.along_m, self.points_m)


def close(points_m: np.ndarray) -> Path:
    """Return the path along (n, 3) points and back to the first, its corners rounded by some centimetres."""
    closed = np.concatenate([points_m, points_m[:1]])
    along = arc_lengths(closed)
    fine = np.linspace(0, along[-1], int(np.ceil(along[-1] / STEP_M)) + 1)[:-1]
    even = interpolate(fine, along, closed)
    reach = len(_ROUNDING) // 2
    padded = np.concatenate([even[-reach:], even, even[:reach]])
    rounded = np.stack([np.convolve(padded[:, k], _ROUNDING, "valid") for k in range(3)], -1)
    rounded = np.concatenate([rounded, rounded[:1]])
    return Path(rounded, arc_lengths(rounded))
