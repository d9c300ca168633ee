"""Files of LiDAR points: `.bin` (KITTI), `.pcd`, `.ply` and `.npz`."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Bool, Float, Float32, Int64

from omniocc.data.formats.files import load_npz, named_once, read_array, whole_numbers
from omniocc.errors import DataError, repr_of
from omniocc.io import read_bytes

LABEL_FIELDS = ("label", "labels", "semantic", "semantics", "class")
"""Names of the field of the class id in a file, in the order in which they are looked for."""
LABEL_SUFFIX = ".label"
TINIEST_M, FARTHEST_M = 1e-6, 1e4
"""Coordinates that a LiDAR measures, in absolute value."""
MOST_OTHERS = 0.01
"""Largest fraction of other coordinates in a file whose numbers are of the right type and unit."""
MOST_COLUMNS = 32
"""Largest number of columns of an array of points; one with more has a column for each point."""
LZF_RATIO = 88
"""Largest ratio of LZF, in which three bytes stand for up to 264."""
PLY_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
PCD_TYPES = {
    kind + size: f"<{kind.lower()}{size}"
    for kind, sizes in (("F", "48"), ("I", "1248"), ("U", "1248"))
    for size in sizes
}
"""Types by what TYPE and SIZE of the header of a PCD file state."""
NOTHING = b"\0 \t\r\n"
"""Bytes that may follow the last point."""


class RawCloud(NamedTuple):
    """The points of a file.

    Attributes:
        points_m: in the frame of the LiDAR, m; rays that did not come back (`came_back`) are left out.
        labels: class id of each, as the file numbers classes; None without any.
    """

    points_m: Float32[np.ndarray, "P 3"]
    labels: Int64[np.ndarray, " P"] | None


def came_back(points_m: Float[np.ndarray, "R 3"]) -> Bool[np.ndarray, " R"]:
    """Return which rows of a scan, in the frame of its LiDAR, are points.

    Where nothing came back, LiDARs and their drivers write (0, 0, 0), nan or inf. Only in the frame of the LiDAR do
    these stand for no place.
    """
    return np.isfinite(points_m).all(axis=1) & (points_m != 0).any(axis=1)


def read_scan(path: Path, columns: int) -> tuple[Float32[np.ndarray, "P 3"], Bool[np.ndarray, " R"]]:
    """Return the points of a file of float32 numbers, and which of its rows they are: labels are stored for all rows.

    Args:
        path: the file, in the frame of the LiDAR.
        columns: numbers of each row, x, y, z (m) first: 4 in KITTI, 5 in nuScenes.

    Raises:
        DataError: if the file is missing or of another size.
    """
    rows = read_rows(path, columns)[:, :3]
    kept = came_back(rows)
    return rows[kept], kept


def read_rows(path: Path, columns: int) -> Float32[np.ndarray, "R columns"]:
    """Return the float32 numbers of a scan of a dataset, in which every LiDAR saw something.

    Raises:
        DataError: if the file is missing, empty or of another size.
    """
    rows = read_array(path, "<f4", (-1, columns))
    if not len(rows):
        raise DataError(f"{path}: the file is empty; copy it again")
    return rows


def read_cloud(path: Path, label_field: str | None = None, columns: int = 4) -> RawCloud:
    """Return the points of a file, with the class ids of the file itself or of the `.label` file beside it.

    A `.label` file holds one uint32 for each point, whose lower 16 bits are the class (SemanticKITTI).

    Args:
        path: the file.
        label_field: name of the field of class ids; None: the first of `LABEL_FIELDS` that there is.
        columns: float32 numbers of each point in a `.bin` file, x, y, z first: 4 in KITTI, 5 in nuScenes.

    Raises:
        DataError: naming the file and what is wrong with it.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise DataError(f"{path}: points are read from {', '.join(READERS)}")
    fields = reader(path) if reader is not read_bin else read_bin(path, columns)
    if missing := [axis for axis in "xyz" if axis not in fields]:
        raise DataError(f"{path}: the field {missing[0]} is missing; the file has {', '.join(fields) or 'none'}")
    if several := [axis for axis in "xyz" if fields[axis].ndim != 1]:
        raise DataError(f"{path}: the field {several[0]} has several numbers for each point; it must have one")
    with np.errstate(over="ignore"):  # beyond float32: not finite, as no point is
        points = np.stack([fields[axis] for axis in "xyz"], axis=1).astype(np.float32)
    kept = came_back(points)
    return RawCloud(points[kept], _labels(path, fields, label_field, kept))


def _labels(
    path: Path, fields: dict[str, np.ndarray], label_field: str | None, kept: Bool[np.ndarray, " R"]
) -> Int64[np.ndarray, " P"] | None:
    """Return the class ids of the points: those of other rows may be anything."""
    if label_field is not None and label_field not in fields:
        raise DataError(f"{path}: there is no field '{label_field}'; the file has {', '.join(fields)}")
    names = LABEL_FIELDS if label_field is None else (label_field,)
    name = next((name for name in names if name in fields), None)
    if name is not None:
        if fields[name].shape != kept.shape:
            shape = f"has the shape {fields[name].shape}"
            raise DataError(
                f"{path}: its field '{name}' {shape}; it must be one whole number for each of {len(kept)} points"
            )
        return whole_numbers(fields[name][kept], f"{path}: its field '{name}'")
    beside = path.with_suffix(LABEL_SUFFIX)
    if not os.path.lexists(beside):
        return None
    return (read_array(beside, "<u4", kept.shape)[kept] & 0xFFFF).astype(np.int64)


def read_bin(path: Path, columns: int = 4) -> dict[str, np.ndarray]:
    """Return x, y, z of a file of float32 numbers, `columns` of them for each point.

    Raises:
        DataError: if the file is missing or of another size, or its numbers cannot be coordinates in metres: those of
            another type, read as float32, are tiny or huge.
    """
    axes = read_array(path, "<f4", (-1, columns)).T[:3]
    size = np.abs(axes)
    strange = np.isfinite(axes) & (size != 0) & ((size < TINIEST_M) | (size > FARTHEST_M))
    fraction = strange.sum() / max(strange.size, 1)
    if fraction > MOST_OTHERS:
        raise DataError(
            f"{path}: {fraction:.0%} of its coordinates are no distances in metres; it must hold {columns} numbers for "
            "each point (columns), of type float32, not float64, and in metres"
        )
    return dict(zip("xyz", axes, strict=False))


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Return x, y, z of the array `points` (P, 3 or more), and the other arrays.

    Raises:
        DataError: naming the file and what is wrong with it.
    """
    arrays = load_npz(path)
    points = arrays.pop("points", None)
    if points is None or points.ndim != 2 or not 3 <= points.shape[1] <= MOST_COLUMNS:
        shape = "is missing" if points is None else f"has the shape {points.shape}"
        raise DataError(f"{path}: its array 'points' {shape}; it must be (P, 3), a row for each point")
    if points.dtype.kind not in "iuf":
        raise DataError(f"{path}: its array 'points' is of {points.dtype}; it must hold numbers, m")
    others = {name: rows for name, rows in arrays.items() if name not in "xyz" or rows.shape == points.shape[:1]}
    named_once((*"xyz", *others), f"{path}: among the columns of 'points' and the arrays")
    return dict(zip("xyz", points.T, strict=False)) | others


def read_ply(path: Path) -> dict[str, np.ndarray]:
    """Return the properties of the vertices of a PLY file, ascii or binary_little_endian.

    Raises:
        DataError: naming the file and what is wrong with it.
    """
    content = read_bytes(path)
    found = re.match(rb"ply\r?\n(.*?)end_header\r?\n", content, re.DOTALL)
    if found is None:
        raise DataError(f"{path}: the header of a PLY file is missing")
    lines = [line.split() for line in found[1].decode("ascii", "replace").splitlines() if line.split()]
    encoding = next((line[1] for line in lines if line[0] == "format" and len(line) > 1), "none")
    elements = [place for place, line in enumerate(lines) if line[0] == "element"]
    if not elements or lines[elements[0]][1:2] != ["vertex"]:
        raise DataError(f"{path}: the first element of the file must be 'vertex'")
    rows = lines[elements[0] + 1 : elements[1] if len(elements) > 1 else None]
    properties = [line for line in rows if line[0] == "property"]
    if unknown := [" ".join(line) for line in properties if len(line) != 3 or line[1] not in PLY_TYPES]:
        raise DataError(f"{path}: '{unknown[0]}' of the vertices cannot be read")
    named_once([line[2] for line in properties], f"{path}: the property")
    if not properties:
        raise DataError(f"{path}: its vertices have no properties")
    dtype = np.dtype([(line[2], "<" + PLY_TYPES[line[1]]) for line in properties])
    count, body = _whole(path, "element vertex", " ".join(lines[elements[0]][2:])), content[found.end() :]
    alone = all(lines[place][2:] == ["0"] for place in elements[1:])
    if encoding == "ascii":
        return _from_text(path, body, dtype, count, alone)
    if encoding != "binary_little_endian":
        raise DataError(f"{path}: the format {encoding} cannot be read; write ascii or binary_little_endian")
    return _from_bytes(path, body, dtype, count, alone)


def read_pcd(path: Path) -> dict[str, np.ndarray]:
    """Return the fields of a PCD file: ascii, binary or binary_compressed.

    Raises:
        DataError: naming the file and what is wrong with it.
    """
    content = read_bytes(path)
    found = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", content, re.MULTILINE)
    if found is None:
        raise DataError(f"{path}: the header of a PCD file is missing, or its line DATA")
    lines = [line.split() for line in content[: found.start()].decode("ascii", "replace").splitlines()]
    lines = [line for line in lines if line and not line[0].startswith("#")]
    named_once([line[0] for line in lines], f"{path}: the line of its header")
    header = {line[0]: line[1:] for line in lines}
    dtype = _pcd_dtype(path, header)
    count, width, height = (
        _whole(path, name, " ".join(header.get(name, default)))
        for name, default in (("POINTS", []), ("WIDTH", header.get("POINTS", [])), ("HEIGHT", ["1"]))
    )
    if width * height != count:
        raise DataError(
            f"{path}: WIDTH {width:,} and HEIGHT {height:,} of the header are not those of {count:,} points"
        )
    body, encoding = content[found.end() :], found[1].decode()
    if encoding == "ascii":
        return _from_text(path, body, dtype, count)
    if encoding == "binary":
        return _from_bytes(path, body, dtype, count)
    if encoding == "binary_compressed":
        return _from_columns(path, _decompressed(path, body, count, count * dtype.itemsize), dtype, count)
    raise DataError(f"{path}: DATA {encoding} cannot be read; known are ascii, binary and binary_compressed")


def _pcd_dtype(path: Path, header: dict[str, list[str]]) -> np.dtype:
    columns = [header.get(key, []) for key in ("FIELDS", "SIZE", "TYPE")]
    counts = header.get("COUNT", ["1"] * len(columns[0]))
    if not columns[0] or len({*map(len, columns), len(counts)}) != 1:
        raise DataError(f"{path}: FIELDS, SIZE, TYPE and COUNT of the header do not agree")
    parts: list[tuple[str, str, tuple[int, ...]]] = []
    for place, (name, size, kind, count) in enumerate(zip(*columns, counts, strict=True)):
        if kind + size not in PCD_TYPES:
            raise DataError(f"{path}: the field {name} of type {kind} and {size} bytes cannot be read")
        times = _whole(path, "COUNT", count)
        parts.append((f"_{place}" if name == "_" else name, PCD_TYPES[kind + size], () if times == 1 else (times,)))
    named_once([name for name, _, _ in parts], f"{path}: the field")
    try:
        return np.dtype(parts)
    except ValueError as error:
        raise DataError(f"{path}: FIELDS, SIZE, TYPE and COUNT of the header are impossible ({error})") from error


def _from_text(path: Path, body: bytes, dtype: np.dtype, count: int, alone: bool = True) -> dict[str, np.ndarray]:
    width = sum(int(np.prod(dtype[name].shape)) for name in dtype.names or ())
    if len(body) + 1 < 2 * width * count:  # a digit and what separates it from the next
        raise DataError(f"{path}: {len(body):,} bytes cannot hold the {count:,} points that the header names")
    lines = body.split(b"\n", count)
    text = b" ".join(lines[:count])
    _check_rest(path, lines[count] if alone and len(lines) > count else b"", count)
    try:
        if b"_" in text:
            raise ValueError("Python alone reads 1_0 as a number")
        rows = np.array(text.split(), np.float64).reshape(count, width)
    except ValueError as error:
        raise DataError(f"{path}: the points are not {count} lines of {width} numbers; it is damaged") from error
    fields, start = {}, 0
    for name in dtype.names or ():
        taken = int(np.prod(dtype[name].shape))
        fields[name] = rows[:, start] if taken == 1 else rows[:, start : start + taken]
        start += taken
    return fields


def _from_bytes(path: Path, body: bytes, dtype: np.dtype, count: int, alone: bool = True) -> dict[str, np.ndarray]:
    if len(body) < count * dtype.itemsize:
        expected = f"{count * dtype.itemsize:,} for {count} points"
        raise DataError(f"{path}: {len(body):,} bytes follow the header instead of {expected}; it is damaged")
    _check_rest(path, body[count * dtype.itemsize :] if alone else b"", count)
    table = np.frombuffer(body, dtype, count)
    return {name: table[name] for name in dtype.names or ()}


def _check_rest(path: Path, rest: bytes, count: int) -> None:
    """Raise DataError if something follows the last point: then the header does not describe the points."""
    if rest.strip(NOTHING):
        raise DataError(f"{path}: {len(rest):,} bytes are left over after the {count:,} points that the header names")


def _from_columns(path: Path, body: bytes, dtype: np.dtype, count: int) -> dict[str, np.ndarray]:
    if len(body) != count * dtype.itemsize:
        raise DataError(f"{path}: {len(body):,} bytes instead of {count * dtype.itemsize:,}; it is damaged")
    fields, start = {}, 0
    for name in dtype.names or ():
        base, shape = dtype[name].base, dtype[name].shape
        size = count * dtype[name].itemsize
        fields[name] = np.frombuffer(body[start : start + size], base).reshape(count, *shape)
        start += size
    return fields


def _decompressed(path: Path, body: bytes, count: int, expected: int) -> bytes:
    if len(body) < 8:
        raise DataError(f"{path}: the file is cut short")
    packed, whole = np.frombuffer(body[:8], "<u4").tolist()
    if whole != expected or whole > LZF_RATIO * packed:
        raise DataError(
            f"{path}: {packed:,} compressed bytes state {whole:,} bytes; the header's points take {expected:,}, and "
            f"nothing shrinks by more than {LZF_RATIO}; it is damaged"
        )
    if len(body) < 8 + packed:
        raise DataError(f"{path}: {len(body) - 8:,} compressed bytes instead of {packed:,}; it is damaged")
    _check_rest(path, body[8 + packed :], count)
    result = np.empty(whole, np.uint8)
    if _lzf(np.frombuffer(body, np.uint8, packed, 8), result) != whole:
        raise DataError(f"{path}: the compressed points are damaged")
    return result.tobytes()


@numba.njit
def _lzf(packed: np.ndarray, result: np.ndarray) -> int:
    """Undo LZF compression; return the number of bytes written, -1 if the input makes no sense."""
    read, written = 0, 0
    while read < len(packed):
        control = int(packed[read])
        read += 1
        if control < 32:  # a run of literal bytes
            length = control + 1
            if read + length > len(packed) or written + length > len(result):
                return -1
            result[written : written + length] = packed[read : read + length]
            read += length
            written += length
            continue
        length = control >> 5
        if length == 7:
            if read >= len(packed):
                return -1
            length += int(packed[read])
            read += 1
        if read >= len(packed):
            return -1
        source = written - ((control & 31) << 8) - int(packed[read]) - 1
        read += 1
        if source < 0 or written + length + 2 > len(result):
            return -1
        for offset in range(length + 2):  # the copy may overlap itself
            result[written + offset] = result[source + offset]
        written += length + 2
    return written


def _whole(path: Path, name: str, text: str) -> int:
    if not re.fullmatch("[0-9]{1,15}", text):
        raise DataError(f"{path}: {name} is {repr_of(text)}; it must be a whole number")
    return int(text)


READERS: dict[str, Callable[[Path], dict[str, np.ndarray]]] = {
    ".bin": read_bin,
    ".pcd": read_pcd,
    ".ply": read_ply,
    ".npz": read_npz,
}
"""Readers by the suffix of the file: each returns the fields of the points by name."""
