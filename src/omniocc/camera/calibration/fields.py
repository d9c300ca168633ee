"""Checked reading of values in calibration files: an error names the key, the value and the remedy."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from omniocc.camera.pose import LEVEL_FORWARD, invert_pose, rigid_pose
from omniocc.camera.protocol import Camera, finite
from omniocc.errors import FAULTS, DataError, reason_of, repr_of, shortened
from omniocc.images import read_mask
from omniocc.io import number_of

ROTATION_TOLERANCE = 1e-3  # largest difference of singular values from 1, for files with few digits


class Calibration(NamedTuple):
    """The arguments of `Rig`."""

    cameras: tuple[Camera, ...]
    ego_from_camera: Float64[Tensor, "N 4 4"]
    names: tuple[str, ...]
    masks: tuple[Bool[Tensor, "_ _"] | None, ...] | None
    road_z_m: float | None = None


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Turn OSError and `FAULTS` of the block into ValueError that begins with `place`; DataError passes."""
    try:
        yield
    except DataError:
        raise
    except (OSError, *FAULTS) as error:
        reason = str(error) if isinstance(error, ValueError) else reason_of(error)
        raise ValueError(f"{place}: {shortened(reason)}") from error


def mapping(value: Any, what: str) -> dict[Any, Any]:
    """Return `value`; raise ValueError if it is no mapping, or empty."""
    if not isinstance(value, dict) or not value:
        raise ValueError(f"{what} is {repr_of(value)}; it must be a mapping with entries")
    return value


def required(entry: dict[str, Any], *keys: str) -> Any:
    """Return the value of the first of `keys` that exists; raise ValueError if none does."""
    for key in keys:
        if key in entry:
            return entry[key]
    raise ValueError(f"{' or '.join(keys)} is missing; is the file whole?")


def number(entry: dict[str, Any], key: str) -> float:
    """Return the finite number under `key`; raise ValueError for anything else."""
    return _number(key, required(entry, key))


def whole(entry: dict[str, Any], key: str) -> int:
    """Return the whole number under `key`; raise ValueError for anything else."""
    return _whole(key, required(entry, key))


def row(entry: dict[str, Any], count: int | None, *keys: str) -> list[float]:
    """Return `count` finite numbers (None: any) of a list, a list of rows or OpenCV's matrix; see `required` for keys.

    Raises:
        ValueError: naming the key that is missing or holds something else.
    """
    value = required(entry, *keys)
    key = next(key for key in keys if key in entry)
    if isinstance(value, dict):
        value = _matrix_data(key, value)
    value = _flat(key, value)
    if not isinstance(value, list) or (count is not None and len(value) != count):
        raise ValueError(f"{key} is {repr_of(value)}; it must be {count or 'a list of'} numbers; is the file whole?")
    return [_number(key, item) for item in value]


def size(entry: dict[str, Any], key: str) -> tuple[int, int]:
    """Return the two whole numbers under `key`."""
    first, second = row(entry, 2, key)
    return _whole(key, first), _whole(key, second)


def pose(rows: Any, name: str) -> Float64[Tensor, "4 4"]:
    """Return the rigid pose of 3 or 4 rows of 4 numbers, with the nearest rotation to the rounded one.

    Raises:
        ValueError: naming the entry that is no pose.
    """
    if not isinstance(rows, list) or len(rows) not in (3, 4):
        raise ValueError(f"{name} is {rows!r}; it must be 3 or 4 rows of 4 numbers")
    if not all(isinstance(line, list) and len(line) == 4 for line in rows):
        raise ValueError(f"{name} is {rows!r}; every row must hold 4 numbers")
    matrix = np.array([[_number(name, value) for value in line] for line in rows[:3]])
    if [_number(name, value) for line in rows[3:] for value in line] not in ([], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"{name}: its last row is {rows[3]!r}; it must be 0, 0, 0, 1")
    left, stretch, right = np.linalg.svd(matrix[:, :3])
    if np.abs(stretch - 1).max() > ROTATION_TOLERANCE or np.linalg.det(matrix[:, :3]) < 0:
        raise ValueError(f"{name}: its 3x3 part stretches by {stretch.round(4).tolist()}; it must be a rotation")
    return rigid_pose(torch.from_numpy(left @ right), torch.from_numpy(matrix[:, 3]))


def ego_from_first(first_from_camera: Float64[Tensor, "N 4 4"]) -> Float64[Tensor, "N 4 4"]:
    """Return poses in an ego frame whose forward is the first camera's and whose origin is the mean position."""
    ego_from_first = rigid_pose(torch.tensor(LEVEL_FORWARD, dtype=torch.float64), torch.zeros(3))
    return centered(ego_from_first @ invert_pose(first_from_camera[0]) @ first_from_camera)


def centered(ego_from_camera: Float64[Tensor, "N 4 4"]) -> Float64[Tensor, "N 4 4"]:
    """Return the same poses with their mean position at the origin."""
    result = ego_from_camera.clone()
    result[:, :3, 3] -= result[:, :3, 3].mean(0)
    return result


def single(camera: Camera, name: str) -> Calibration:
    """Return a rig of one camera without a pose: its forward direction is that of the camera."""
    return Calibration((camera,), ego_from_first(torch.eye(4, dtype=torch.float64)[None]), (name,), None)


def read_mask_of(name: str, file: Path, camera: Camera) -> Bool[Tensor, "height width"]:
    """Return where a mask is not 0; raise ValueError, with `name`, if missing, unreadable or of another size."""
    try:
        return torch.from_numpy(read_mask(file, (camera.width, camera.height)))
    except DataError as error:
        raise ValueError(f"{name} {error}") from error


def _number(key: str, value: Any) -> float:
    if isinstance(value, str):  # PyYAML reads 1e-5, without a point, as text
        try:
            value = number_of(value)
        except ValueError:
            raise ValueError(f"{key} is {repr_of(value)}; it must be a finite number") from None
    return finite(key, value)


def _whole(key: str, value: Any) -> int:
    result = _number(key, value)
    if result != int(result):
        raise ValueError(f"{key} is {repr_of(value)}; it must be a whole number")
    return int(result)


def _flat(key: str, value: Any) -> Any:
    """Return the items of a list of rows; anything else as it is; raise ValueError if the rows differ in length."""
    if not isinstance(value, list) or not value or not all(isinstance(line, list) for line in value):
        return value
    if len({len(line) for line in value}) > 1:
        raise ValueError(f"{key} is {repr_of(value)}; its rows differ in length; is the file whole?")
    return [item for line in value for item in line]


def _matrix_data(key: str, value: dict[str, Any]) -> list[Any]:
    data = _flat(key, required(value, "data"))
    count = whole(value, "rows") * whole(value, "cols")
    if not isinstance(data, list) or len(data) != count:
        held = len(data) if isinstance(data, list) else repr(data)
        raise ValueError(f"{key} is {value['rows']}x{value['cols']} but holds {held} numbers; is the file whole?")
    return data
