"""Closed paths, and timetables along them that are functions of time: any moment can be asked for in any order."""

from dataclasses import dataclass

import numpy as np

_STEP_M = 0.5
_ROUNDING = np.hanning(15)[1:-1] / np.hanning(15).sum()  # over 7 m
_LATERAL_MPS2 = 2.6
_ACCELERATE_MPS2, _BRAKE_MPS2 = 1.8, 2.2
_HURRY = 1.12  # how much faster than planned a path may be driven


@dataclass(frozen=True)
class Path:
    """A closed path: (n + 1, 3) points whose last is the first, at (n + 1,) arc lengths."""

    points_m: np.ndarray
    along_m: np.ndarray

    @property
    def length_m(self) -> float:
        """Once around."""
        return float(self.along_m[-1])

    def at(self, along_m: np.ndarray) -> np.ndarray:
        """(..., 3) positions at any arc lengths (they wrap around)."""
        wrapped = np.mod(along_m, self.length_m)
        return np.stack([np.interp(wrapped, self.along_m, self.points_m[:, k]) for k in range(3)], -1)


def close(points_m: np.ndarray) -> Path:
    """The closed path along (n, 3) points, its corners rounded by some centimetres, in steps of half a metre."""
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


@dataclass(frozen=True)
class Timetable:
    """Arc length as a function of time on a closed path, with constant acceleration in each of m pieces.

    Attributes:
        time_s: (m + 1,) from 0 to the period.
        along_m: (m + 1,) from 0 to the path's length.
        speed_mps: (m + 1,) at these times.
    """

    time_s: np.ndarray
    along_m: np.ndarray
    speed_mps: np.ndarray

    @property
    def period_s(self) -> float:
        """Time for once around."""
        return float(self.time_s[-1])

    def at(self, time_s: np.ndarray | float) -> np.ndarray:
        """Arc length, counted on over the rounds, at any times."""
        rounds = np.floor(np.asarray(time_s) / self.period_s)
        time = time_s - rounds * self.period_s
        k = np.clip(np.searchsorted(self.time_s, time, side="right") - 1, 0, len(self.time_s) - 2)
        since, whole = time - self.time_s[k], self.time_s[k + 1] - self.time_s[k]
        gain = (self.speed_mps[k + 1] - self.speed_mps[k]) / whole
        return rounds * self.along_m[-1] + self.along_m[k] + since * (self.speed_mps[k] + 0.5 * gain * since)

    def least_gap_m(self, delay_s: np.ndarray) -> np.ndarray:
        """(D,) shortest distance ever between two that go the same round `delay_s` (D,) apart."""
        time = np.arange(0, self.period_s, 0.25)
        return (self.at(time[None] + delay_s[:, None]) - self.at(time)[None]).min(1)


def timetable(path: Path, free_mps: np.ndarray, stops_m: np.ndarray, dwell_s: float, multiple_s: float) -> Timetable:
    """Drives a path: free speed, slower in curves, full stops.

    Args:
        path: what is driven.
        free_mps: (m + 1,) speed wanted at evenly spaced arc lengths.
        stops_m: (S,) arc lengths where to stop.
        dwell_s: how long to stop there.
        multiple_s: the period becomes a multiple of this, by slowing everything down (or speeding it up a little).
    """
    count = len(free_mps) - 1
    step = path.length_m / count
    stop = np.unique(np.round(np.mod(stops_m, path.length_m) / step).astype(int) % count)
    speed = np.minimum(free_mps[:-1], _curve_speed(path, step * np.arange(count)))
    speed[stop] = 0
    for k in range(-2 * count, 0):
        speed[k % count] = min(speed[k % count], np.sqrt(speed[(k - 1) % count] ** 2 + 2 * _ACCELERATE_MPS2 * step))
    for k in range(2 * count, 0, -1):
        speed[k % count] = min(speed[k % count], np.sqrt(speed[(k + 1) % count] ** 2 + 2 * _BRAKE_MPS2 * step))
    point = np.sort(np.concatenate([np.arange(count + 1), stop]))  # stops twice: the car stands between the two
    at_point = speed[point % count]
    standing = np.diff(point) == 0
    duration = np.where(standing, dwell_s, 2 * step / np.where(standing, 1.0, at_point[:-1] + at_point[1:]))
    time = np.concatenate([[0], np.cumsum(duration)])
    stretch = max(np.ceil(time[-1] / multiple_s / _HURRY), 1) * multiple_s / time[-1]
    return Timetable(time * stretch, point * step, at_point / stretch)


def _curve_speed(path: Path, along_m: np.ndarray) -> np.ndarray:
    """(n,) speed at which a curve pulls sideways with 2.6 m/s2, judged over chords of 4 m."""
    here, before, after = (path.at(along_m + shift)[:, :2] for shift in (0, -4, 4))
    ahead, behind = after - here, here - before
    turn = np.arctan2(behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0], (behind * ahead).sum(1))
    return np.sqrt(_LATERAL_MPS2 / np.maximum(np.abs(turn) / 4, 1e-3))
