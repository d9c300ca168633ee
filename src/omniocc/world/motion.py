"""Closed paths, and timetables along them that are functions of time: any moment can be asked for in any order."""

from dataclasses import dataclass

import numpy as np

_STEP_M = 1.0
_LATERAL_MPS2 = 2.6
_ACCELERATE_MPS2, _BRAKE_MPS2 = 1.8, 2.2


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
    """The closed path through (n, 3) points, with points about a metre apart."""
    closed = np.concatenate([points_m, points_m[:1]])
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    fine = np.linspace(0, along[-1], int(np.ceil(along[-1] / _STEP_M)) + 1)
    return Path(np.stack([np.interp(fine, along, closed[:, k]) for k in range(3)], -1), fine)


@dataclass(frozen=True)
class Timetable:
    """Arc length as a function of time on a closed path: (m,) times from 0 to `period_s`, (m,) arc lengths from 0 to the path's length."""

    time_s: np.ndarray
    along_m: np.ndarray

    @property
    def period_s(self) -> float:
        """Time for once around."""
        return float(self.time_s[-1])

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Arc length, counted on over the rounds, at any times."""
        rounds = np.floor(np.asarray(time_s) / self.period_s)
        return rounds * self.along_m[-1] + np.interp(time_s - rounds * self.period_s, self.time_s, self.along_m)

    def least_gap_m(self, delay_s: np.ndarray) -> np.ndarray:
        """(D,) shortest distance ever between two that go the same round `delay_s` (D,) apart."""
        time = np.arange(0, self.period_s, 0.25)
        return (self.at(time[None] + delay_s[:, None]) - self.at(time)[None]).min(1)


def timetable(path: Path, free_mps: np.ndarray, stops_m: np.ndarray, dwell_s: float, multiple_s: float) -> Timetable:
    """Drives a path: free speed, slower in curves, full stops.

    Args:
        path: with n + 1 points.
        free_mps: (n + 1,) speed wanted at each point.
        stops_m: (S,) arc lengths where to stop for `dwell_s`.
        multiple_s: the period becomes a multiple of this, by slowing everything down a little.
    """
    count = len(path.along_m) - 1
    step = path.length_m / count
    speed = np.minimum(free_mps[:-1], _curve_speed(path, step))
    stop = np.unique(np.round(np.mod(stops_m, path.length_m) / step).astype(int) % count)
    speed[stop] = 0
    for k in range(-2 * count, 0):
        speed[k % count] = min(speed[k % count], np.sqrt(speed[(k - 1) % count] ** 2 + 2 * _ACCELERATE_MPS2 * step))
    for k in range(2 * count, 0, -1):
        speed[k % count] = min(speed[k % count], np.sqrt(speed[(k + 1) % count] ** 2 + 2 * _BRAKE_MPS2 * step))
    duration = 2 * step / (speed + np.roll(speed, -1))
    stopping = np.isin(np.arange(count), stop)
    pieces = np.concatenate([duration, np.full(len(stop), dwell_s)])
    lengths = np.concatenate([np.full(count, step), np.zeros(len(stop))])
    key = np.concatenate([np.arange(count) + 0.5 * stopping, stop])
    order = np.argsort(key, kind="stable")
    time = np.concatenate([[0], np.cumsum(pieces[order])])
    along = np.concatenate([[0], np.cumsum(lengths[order])])
    return Timetable(time * (np.ceil(time[-1] / multiple_s) * multiple_s / time[-1]), along)


def _curve_speed(path: Path, step_m: float) -> np.ndarray:
    """(n,) speed at which a curve pulls sideways with 2.6 m/s2, over chords of four steps."""
    points = path.points_m[:-1, :2]
    ahead, behind = np.roll(points, -4, 0) - points, points - np.roll(points, 4, 0)
    turn = np.arctan2(behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0], (behind * ahead).sum(1))
    curvature = np.abs(turn) / (4 * step_m)
    return np.sqrt(_LATERAL_MPS2 / np.maximum(curvature, 1e-3))
