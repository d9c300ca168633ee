"""Values of calibration files, checked where they are read: an error names the key, the value and what to do."""

from typing import Any, NamedTuple

import numpy as np
import torch
import yaml
from jaxtyping import Bool, Float64
from torch import Tensor

from omniocc.camera.pose import LEVEL_FORWARD, invert_pose
from omniocc.camera.protocol import Camera, finite

ROUNDED = 1e-3  # how far from a rotation a matrix may be that was written with few digits


class Calibration(NamedTuple):
    """The arguments of `Rig`."""

    cameras: tuple[Camera, ...]
    ego_from_camera: Float64[Tensor, "N 4 4"]
    names: tuple[str, ...]
    masks: tuple[Bool[Tensor, "_ _"] | None, ...] | None


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices, which are mappings of rows, cols, dt and data."""


def _matrix(loader: yaml.SafeLoader, node: yaml.Node) -> dict[Any, Any]:
    assert isinstance(node, yaml.MappingNode)
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def parse_yaml(text: str) -> Any:
    """Content of a YAML text, of OpenCV's dialect too. Raises ValueError."""
    if text.startswith("%YAML:"):  # OpenCV's header is no YAML
        text = text.partition("\n")[2]
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise ValueError(f"this is no YAML that can be read: {error}") from error


def required(entry: dict[str, Any], *keys: str) -> Any:
    """The value of the first of `keys` that is there."""
    for key in keys:
        if key in entry:
            return entry[key]
    raise ValueError(f"{' or '.join(keys)} is missing; is the file whole?")


def number(entry: dict[str, Any], key: str) -> float:
    """A finite number."""
    return _number(key, required(entry, key))


def whole(entry: dict[str, Any], key: str) -> int:
    """A whole number."""
    return _whole(key, required(entry, key))


def row(entry: dict[str, Any], count: int | None, *keys: str) -> list[float]:
    """`count` finite numbers (any number if None), as a list or as OpenCV's matrix, under the first of `keys`."""
    value = required(entry, *keys)
    key = next(key for key in keys if key in entry)
    if isinstance(value, dict):
        value = _matrix_data(key, value)
    if not isinstance(value, list) or (count is not None and len(value) != count):
        raise ValueError(f"{key} is {value!r}; it must be {count or 'a list of'} numbers; is the file whole?")
    return [_number(key, item) for item in value]


def size(entry: dict[str, Any], *keys: str) -> tuple[int, int]:
    """Two whole numbers."""
    first, second = row(entry, 2, *keys)
    return _whole(keys[0], first), _whole(keys[0], second)


def pose(rows: Any, whose: str) -> Float64[Tensor, "4 4"]:
    """A rigid pose from 3 or 4 rows of 4 numbers; what rounding took from the rotation is given back."""
    if not isinstance(rows, list) or len(rows) not in (3, 4):
        raise ValueError(f"{whose} is {rows!r}; it must be 3 or 4 rows of 4 numbers")
    if not all(isinstance(line, list) and len(line) == 4 for line in rows):
        raise ValueError(f"{whose} is {rows!r}; every row must hold 4 numbers")
    matrix = np.array([[_number(whose, value) for value in line] for line in rows[:3]])
    left, stretch, right = np.linalg.svd(matrix[:, :3])
    if np.abs(stretch - 1).max() > ROUNDED or np.linalg.det(matrix[:, :3]) < 0:
        raise ValueError(f"{whose}: its 3x3 part stretches by {stretch.round(4).tolist()}; it must be a rotation")
    result = torch.eye(4, dtype=torch.float64)
    result[:3, :3] = torch.from_numpy(left @ right)
    result[:3, 3] = torch.from_numpy(matrix[:, 3])
    return result


def ego_from_first(first_from_camera: Float64[Tensor, "N 4 4"]) -> Float64[Tensor, "N 4 4"]:
    """Poses in a level ego frame that looks where the first camera looks, its origin amid the cameras."""
    ego_from_first = torch.eye(4, dtype=torch.float64)
    ego_from_first[:3, :3] = torch.tensor(LEVEL_FORWARD, dtype=torch.float64)
    return centered(ego_from_first @ invert_pose(first_from_camera[0]) @ first_from_camera)


def centered(ego_from_camera: Float64[Tensor, "N 4 4"]) -> Float64[Tensor, "N 4 4"]:
    """The same poses with their mean position at the origin."""
    result = ego_from_camera.clone()
    result[:, :3, 3] -= result[:, :3, 3].mean(0)
    return result


def alone(camera: Camera, name: str) -> Calibration:
    """A file with one camera and no pose: a rig that looks where the camera looks."""
    return Calibration((camera,), ego_from_first(torch.eye(4, dtype=torch.float64)[None]), (name,), None)


def _number(key: str, value: Any) -> float:
    if isinstance(value, str):  # PyYAML reads 1e-5, without a point, as text
        try:
            value = float(value)
        except ValueError:
            raise ValueError(f"{key} is {value!r}; it must be a number") from None
    return finite(key, value)


def _whole(key: str, value: Any) -> int:
    result = _number(key, value)
    if result != int(result):
        raise ValueError(f"{key} is {value!r}; it must be a whole number")
    return int(result)


def _matrix_data(key: str, value: dict[str, Any]) -> list[Any]:
    data = required(value, "data")
    wanted = whole(value, "rows") * whole(value, "cols")
    if not isinstance(data, list) or len(data) != wanted:
        held = len(data) if isinstance(data, list) else repr(data)
        raise ValueError(f"{key} says {value['rows']}x{value['cols']} but holds {held} numbers; is the file whole?")
    return data
