"""Classes of the points of a log: from the ids in its files to a table of classes."""

import colorsys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int64, UInt8

from omniocc.classes import FREE, OCCUPANCY_CLASSES, UNKNOWN, WORLD_CLASSES, ClassTable, SemanticClass
from omniocc.errors import DataError
from omniocc.io import read_yaml

UNKNOWN_NAME = "unknown"
FREE_NAME = "free"
GOLDEN = 0.618034


class PointClasses(NamedTuple):
    """The meaning of the ids in files.

    Attributes:
        table: the classes.
        of_id: class of every id in the files, 255 unknown; None: ids are not read, all points are occupied.
    """

    table: ClassTable
    of_id: dict[int, int] | None


def read_point_classes(path: Path | None) -> PointClasses:
    """Return the classes that a YAML of `id: name` or `id: {name, rgb}` lists; without a file, free and occupied.

    Several ids may have one name; points of `unknown` get the class 255. Names of the virtual world alone give its
    table, so that its networks can be used; all others get ids in the order of the file.

    Raises:
        DataError: naming the file and the entry that is wrong.
    """
    if path is None:
        return PointClasses(OCCUPANCY_CLASSES, None)
    content = read_yaml(path)
    if not isinstance(content, dict) or not content:
        raise DataError(f"{path}: it must map ids of the files to names of classes, as '40: road'")
    entries = {_id(path, key): _entry(path, key, value) for key, value in content.items()}
    colors: dict[str, tuple[int, ...] | None] = {}
    for name, rgb in entries.values():
        if name != UNKNOWN_NAME:
            if rgb is not None and colors.get(name) not in (None, rgb):
                raise DataError(f"{path}: the class '{name}' has the colours {colors[name]} and {rgb}; keep one")
            colors[name] = colors.get(name) or rgb
    table = _world_table(list(colors)) or _own_table(path, colors)
    plain = str.lower if table is WORLD_CLASSES else str
    ids = {plain(name): place for place, name in enumerate(table.names)}
    return PointClasses(table, {raw: ids.get(plain(name), UNKNOWN) for raw, (name, _) in entries.items()})


def classes_of(
    labels: Int64[np.ndarray, " P"] | None, count: int, classes: PointClasses, where: str
) -> UInt8[np.ndarray, " P"]:
    """Return the class of every point; raise DataError if a file has no ids, or ids that are not in the table."""
    if classes.of_id is None:
        return np.full(count, OCCUPANCY_CLASSES.occupied[0], np.uint8)
    if labels is None:
        raise DataError(
            f"{where}: its points have no class ids: a field 'label', or a .label file beside; without them leave "
            "lidar.classes out"
        )
    found, places = np.unique(labels, return_inverse=True)
    if unknown := [raw for raw in found.tolist() if raw not in classes.of_id]:
        raise DataError(f"{where}: the class ids {unknown[:8]} are not in the YAML of lidar.classes; add them to it")
    return np.array([classes.of_id[raw] for raw in found.tolist()], np.uint8)[places.reshape(-1)]


def _id(path: Path, key: Any) -> int:
    if isinstance(key, bool) or not isinstance(key, int) or key < 0:
        raise DataError(f"{path}: '{key}' is no id; it must be a whole number from 0")
    return key


def _entry(path: Path, key: Any, value: Any) -> tuple[str, tuple[int, ...] | None]:
    name, rgb = (value.get("name"), value.get("rgb")) if isinstance(value, Mapping) else (value, None)
    if not isinstance(name, str) or not name or name.lower() == FREE_NAME:
        raise DataError(f"{path}: id {key} has the name {name!r}; points are of a class, or '{UNKNOWN_NAME}'")
    if rgb is not None and not _is_color(rgb):
        raise DataError(f"{path}: id {key} has rgb: {rgb}; give three whole numbers from 0 to 255")
    return name if name.lower() != UNKNOWN_NAME else UNKNOWN_NAME, None if rgb is None else tuple(rgb)


def _is_color(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(type(v) is int and 0 <= v <= 255 for v in value)


def _world_table(names: list[str]) -> ClassTable | None:
    known = {name.lower() for name in WORLD_CLASSES.names}
    return WORLD_CLASSES if all(name.lower() in known for name in names) else None


def _own_table(path: Path, colors: Mapping[str, tuple[int, ...] | None]) -> ClassTable:
    rows = [SemanticClass(FREE, FREE_NAME, (255, 255, 255))]
    for place, (name, rgb) in enumerate(colors.items(), start=1):
        drawn = tuple(round(255 * part) for part in colorsys.hsv_to_rgb(place * GOLDEN % 1, 0.7, 0.9))
        red, green, blue = drawn if rgb is None else rgb
        rows.append(SemanticClass(place, name, (red, green, blue)))
    try:
        return ClassTable(tuple(rows))
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
