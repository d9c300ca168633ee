"""Closed paths, on which people walk."""

from dataclasses import dataclass

import numpy as np

_STEP_M = 0.5
_ROUNDING = np.hanning(15)[1:-1] / np.hanning(15).sum()  # over 7 m


@dataclass(frozen=True)
class Path:
    """A closed path: (n + 1, 3) points whose last is the first, at (n + 1,) arc lengths."""

    points_m: np.ndarray
    along_m: np.ndarray

    @property
    def length_m(self) -> float:
        """Return the length of the whole path."""
        return float(self.along_m[-1])

    def at(self, along_m: np.ndarray) -> np.ndarray:
        """Return (..., 3) positions at any arc lengths, which wrap around."""
        wrapped = np.mod(along_m, self.length_m)
        return np.stack([np.interp(wrapped, self.along_m, self.points_m[:, k]) for k in range(3)], -1)


def close(points_m: np.ndarray) -> Path:
    """Close a path along (n, 3) points, its corners rounded by some centimetres, in steps of half a metre."""
    closed = np.concatenate([points_m, points_m[:1]])
    along = _lengths(closed)
    fine = np.linspace(0, along[-1], int(np.ceil(along[-1] / _STEP_M)) + 1)[:-1]
    even = np.stack([np.interp(fine, along, closed[:, k]) for k in range(3)], -1)
    reach = len(_ROUNDING) // 2
    padded = np.concatenate([even[-reach:], even, even[:reach]])
    rounded = np.stack([np.convolve(padded[:, k], _ROUNDING, "valid") for k in range(3)], -1)
    rounded = np.concatenate([rounded, rounded[:1]])
    return Path(rounded, _lengths(rounded))


def _lengths(points_m: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])
