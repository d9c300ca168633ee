"""Files of poses with time stamps, and poses as options state them."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from omniocc.camera.protocol import numbers
from omniocc.data.formats.pose_table import W_FIRST, W_LAST, TimeUnit, read_table
from omniocc.data.formats.poses import is_euroc, quaternion_pose, rigid
from omniocc.errors import DataError
from omniocc.io import number_of

PosesFormat = Literal["csv", "tum", "kitti"]
PER_SECOND: dict[TimeUnit, int] = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


EXACT = 1e-9
"""Largest error of a rotation that is kept as it is given; others are mended."""


class TimedPoses(NamedTuple):
    """Poses in the order of time.

    Attributes:
        times_s: (P,) increasing.
        poses: (P, 4, 4) world_from_body.
    """

    times_s: Float64[np.ndarray, " P"]
    poses: Float64[np.ndarray, "P 4 4"]


def seconds(text: str, unit: TimeUnit) -> float:
    """Return a time stamp in s; whole numbers are divided exactly; raise ValueError if it is no finite number."""
    value = number_of(text)
    digits = text.strip()
    return (int(digits) if digits.lstrip("-").isdigit() else value) / PER_SECOND[unit]


def read_timed_poses(path: Path, kind: PosesFormat, unit: TimeUnit, times: Path | None = None) -> TimedPoses:
    """Return the poses of a file.

    * `csv`: time, x, y, z (m) and quaternion w, x, y, z, with EuRoC's nine further numbers or without; or time and the
      12 or 16 numbers of a matrix, row by row.
    * `tum`: time, x, y, z and quaternion x, y, z, w.
    * `kitti`: the 12 numbers of a matrix; the times are the lines of the file `times`.

    A header may name the columns, see `omniocc.data.formats.pose_table`: its order and unit of the time then rule.

    Raises:
        DataError: naming file and line.
    """
    if (kind == "kitti") != (times is not None):
        raise DataError(f"{path}: poses_times is for poses_format=kitti, and needed there: a file with a time a line")
    rows = read_table(path, () if kind == "kitti" else ("time",), W_LAST if kind == "tum" else W_FIRST)
    if not rows:
        raise DataError(f"{path}: the file holds no poses; is poses_format={kind} right?")
    poses = [_checked(row.where, lambda row=row: _pose(row.pose, kind)) for row in rows]
    stamps = rows if times is None else read_table(times, ("time",))
    if len(stamps) != len(rows):
        raise DataError(f"{times}: {len(stamps)} times, but {path} holds {len(rows)} poses; each needs one")
    times_s = np.array([_checked(row.where, lambda row=row: seconds(row.keys[0], row.unit or unit)) for row in stamps])
    order = np.argsort(times_s, kind="stable")
    if (same := np.flatnonzero(np.diff(times_s[order]) == 0)).size:
        raise DataError(f"{stamps[order[same[0] + 1]].where}: a pose of this time is there already; keep one")
    return TimedPoses(times_s[order], np.stack(poses)[order])


def _checked(where: str, read: Callable[[], Any]) -> Any:
    try:
        return read()
    except ValueError as error:
        raise DataError(f"{where}: {error}") from error


def _pose(words: Sequence[str], kind: PosesFormat) -> Float64[np.ndarray, "4 4"]:
    values = [number_of(word) for word in words]
    if len(values) == 7 and kind != "kitti":
        return quaternion_pose(values[3:], values[:3], "the pose")
    if kind == "csv" and is_euroc(values):
        return quaternion_pose(values[3:7], values[:3], "the pose")
    if len(values) in (12, 16) and kind != "tum":
        if values[12:] not in ([], [0, 0, 0, 1]):
            raise ValueError(f"the last row of the matrix is {values[12:]}; it must be 0, 0, 0, 1")
        given = np.array([*values[:12], 0, 0, 0, 1], np.float64).reshape(4, 4)
        mended = rigid(given, "the pose")
        return given if np.abs(mended - given).max() < EXACT else mended
    expected = {"csv": "a time and 7, 12 or 16", "tum": "a time and 7", "kitti": "12"}[kind]
    raise ValueError(f"{len(values)} numbers of a pose; poses_format={kind} has {expected} in a line")


def stated_pose(name: str, value: Any) -> Float64[np.ndarray, "4 4"]:
    """Return the pose that an option states: rows of a matrix, or `{position_m: [3], quaternion_wxyz: [4]}`.

    Raises:
        ValueError: naming the option.
    """
    if isinstance(value, Mapping):
        if set(value) != {"position_m", "quaternion_wxyz"}:
            raise ValueError(f"{name} has the keys {sorted(value)}; it needs position_m and quaternion_wxyz")
        position = numbers(f"{name}.position_m", value["position_m"], 3, 3)
        return quaternion_pose(numbers(f"{name}.quaternion_wxyz", value["quaternion_wxyz"], 4, 4), position, name)
    if not isinstance(value, list | tuple) or len(value) not in (3, 4):
        raise ValueError(f"{name} is {value!r}; give rows of a 4x4 matrix, or position_m and quaternion_wxyz")
    rows = np.array([numbers(f"a row of {name}", row, 4, 4) for row in value])
    if len(rows) == 4 and rows[3].tolist() != [0, 0, 0, 1]:
        raise ValueError(f"the last row of {name} is {rows[3].tolist()}; it must be 0, 0, 0, 1")
    return rigid(rows, name)
