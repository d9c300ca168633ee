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
"""Names that the field of class ids may have in a file; the first that is found is read."""
TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "timestamps", "offset_time", "time_offset")
"""Names that the field of the points' times has in the messages of LiDAR drivers; the first that is found is read."""
LABEL_SUFFIX = ".label"
TINIEST_M, FARTHEST_M = 1e-6, 1e4
"""Smallest and largest absolute value, other than 0, of a plausible coordinate."""
MAX_IMPLAUSIBLE_FRACTION = 0.01
"""Largest fraction of implausible coordinates in a file; above it the type or unit of its numbers is wrong."""
MAX_COLUMNS = 32
"""Largest number of columns of an array of points; an array with more is taken to be transposed."""
MAX_LZF_RATIO = 88
"""Largest compression ratio of LZF: three compressed bytes give at most 264."""
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
"""NumPy types by TYPE and SIZE in the header of a PCD file, such as F4."""
PADDING = b"\0 \t\r\n"
"""Bytes that may follow the last point."""


class RawCloud(NamedTuple):
    """The points of a file.

    Attributes:
        points_m: in the frame of the LiDAR, m; rays that did not come back (`came_back`) are left out.
        labels: class id of each, as the file numbers classes; None without any.
        times: of each, in the file's unit and type; None without any.
    """

    points_m: Float32[np.ndarray, "P 3"]
    labels: Int64[np.ndarray, " P"] | None
    times: np.ndarray | None = None


def came_back(points_m: Float[np.ndarray, "R 3"]) -> Bool[np.ndarray, " R"]:
    """Return which rows of a scan, in the frame of its LiDAR, are points.

    LiDARs and their drivers write (0, 0, 0), nan or inf for a ray that did not come back. In another frame (0, 0, 0)
    could be a point.
    """
    return np.isfinite(points_m).all(axis=1) & (points_m != 0).any(axis=1)


def read_scan(path: Path, columns: int) -> tuple[Float32[np.ndarray, "P 3"], Bool[np.ndarray, " R"]]:
    """Return the points of a file of float32 numbers, and which of its rows are points: labels exist for all rows.

    Args:
        path: the file, whose coordinates are in the frame of the LiDAR.
        columns: numbers in each row, x, y, z (m) first: 4 in KITTI, 5 in nuScenes.

    Raises:
        DataError: if the file is missing or of another size.
    """
    rows = read_rows(path, columns)[:, :3]
    kept = came_back(rows)
    return rows[kept], kept


def read_rows(path: Path, columns: int) -> Float32[np.ndarray, "R columns"]:
    """Return the rows of float32 numbers of a scan; an empty scan is an error, since a LiDAR always sees something.

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
        columns: float32 numbers for each point in a `.bin` file, x, y, z first: 4 in KITTI, 5 in nuScenes.

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
    with np.errstate(over="ignore"):  # numbers too large for float32 become inf and are left out
        points = np.stack([fields[axis] for axis in "xyz"], axis=1).astype(np.float32)
    kept = came_back(points)
    stamps = (fields[name] for name in TIME_FIELDS if name in fields)
    times = next((field[kept] for field in stamps if field.shape == kept.shape and field.dtype.kind in "iuf"), None)
    return RawCloud(points[kept], _read_labels(path, fields, label_field, kept), times)


def _read_labels(
    path: Path, fields: dict[str, np.ndarray], label_field: str | None, kept: Bool[np.ndarray, " R"]
) -> Int64[np.ndarray, " P"] | None:
    """Return the class ids of the points; the ids of rows that are no points are not checked."""
    if label_field is not None and label_field not in fields:
        raise DataError(f"{path}: there is no field '{label_field}'; the file has {', '.join(fields)}")
    names = LABEL_FIELDS if label_field is None else (label_field,)
    found = next((name for name in names if name in fields), None)
    if found is not None:
        if fields[found].shape != kept.shape:
            shape = f"has the shape {fields[found].shape}"
            raise DataError(
                f"{path}: its field '{found}' {shape}; it must be one whole number for each of {len(kept)} points"
            )
        return whole_numbers(fields[found][kept], f"{path}: its field '{found}'")
    beside = path.with_suffix(LABEL_SUFFIX)
    if not os.path.lexists(beside):
        return None
    return (read_array(beside, "<u4", kept.shape)[kept] & 0xFFFF).astype(np.int64)


def read_bin(path: Path, columns: int = 4) -> dict[str, np.ndarray]:
    """Return x, y, z of a file of float32 numbers, `columns` of them for each point.

    Raises:
        DataError: if the file is missing or of another size, or its numbers are implausible as coordinates in metres:
            numbers of another type are tiny or huge when they are read as float32.
    """
    axes = read_array(path, "<f4", (-1, columns)).T[:3]
    absolute = np.abs(axes)
    implausible = np.isfinite(axes) & (absolute != 0) & ((absolute < TINIEST_M) | (absolute > FARTHEST_M))
    fraction = implausible.sum() / max(implausible.size, 1)
    if fraction > MAX_IMPLAUSIBLE_FRACTION:
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
    if points is None or points.ndim != 2 or not 3 <= points.shape[1] <= MAX_COLUMNS:
        shape = "is missing" if points is None else f"has the shape {points.shape}"
        raise DataError(f"{path}: its array 'points' {shape}; it must be (P, 3), a row for each point")
    if points.dtype.kind not in "iuf":
        raise DataError(f"{path}: its array 'points' is of {points.dtype}; it must hold numbers, m")
    # arrays x, y, z with one number per point are kept, so that they are refused beside the columns of 'points'
    others = {name: array for name, array in arrays.items() if name not in "xyz" or array.shape == points.shape[:1]}
    named_once((*"xyz", *others), f"{path}: among the columns of 'points' and the arrays")
    return dict(zip("xyz", points.T, strict=False)) | others


def read_ply(path: Path) -> dict[str, np.ndarray]:
    """Return the properties of the vertices of a PLY file, ascii or binary_little_endian.

    Raises:
        DataError: naming the file and what is wrong with it.
    """
    content = read_bytes(path)
    header = re.match(rb"ply\r?\n(.*?)end_header\r?\n", content, re.DOTALL)
    if header is None:
        raise DataError(f"{path}: the header of a PLY file is missing")
    lines = [line.split() for line in header[1].decode("ascii", "replace").splitlines() if line.split()]
    encoding = next((line[1] for line in lines if line[0] == "format" and len(line) > 1), "none")
    elements = [index for index, line in enumerate(lines) if line[0] == "element"]
    if not elements or lines[elements[0]][1:2] != ["vertex"]:
        raise DataError(f"{path}: the first element of the file must be 'vertex'")
    vertex_lines = lines[elements[0] + 1 : elements[1] if len(elements) > 1 else None]
    properties = [line for line in vertex_lines if line[0] == "property"]
    if unknown := [" ".join(line) for line in properties if len(line) != 3 or line[1] not in PLY_TYPES]:
        raise DataError(f"{path}: '{unknown[0]}' of the vertices cannot be read")
    named_once([line[2] for line in properties], f"{path}: the property")
    if not properties:
        raise DataError(f"{path}: its vertices have no properties")
    dtype = np.dtype([(line[2], "<" + PLY_TYPES[line[1]]) for line in properties])
    count, body = _parse_whole(path, "element vertex", " ".join(lines[elements[0]][2:])), content[header.end() :]
    vertices_only = all(lines[index][2:] == ["0"] for index in elements[1:])
    if encoding == "ascii":
        return _parse_text(path, body, dtype, count, vertices_only)
    if encoding != "binary_little_endian":
        raise DataError(f"{path}: the format {encoding} cannot be read; write ascii or binary_little_endian")
    return _parse_rows(path, body, dtype, count, vertices_only)


def read_pcd(path: Path) -> dict[str, np.ndarray]:
    """Return the fields of a PCD file: ascii, binary or binary_compressed.

    Raises:
        DataError: naming the file and what is wrong with it.
    """
    content = read_bytes(path)
    data_line = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", content, re.MULTILINE)
    if data_line is None:
        raise DataError(f"{path}: the header of a PCD file is missing, or its line DATA")
    lines = [line.split() for line in content[: data_line.start()].decode("ascii", "replace").splitlines()]
    lines = [line for line in lines if line and not line[0].startswith("#")]
    named_once([line[0] for line in lines], f"{path}: the line of its header")
    header = {line[0]: line[1:] for line in lines}
    dtype = _parse_pcd_dtype(path, header)
    count, width, height = (
        _parse_whole(path, name, " ".join(header.get(name, default)))
        for name, default in (("POINTS", []), ("WIDTH", header.get("POINTS", [])), ("HEIGHT", ["1"]))
    )
    if width * height != count:
        raise DataError(
            f"{path}: WIDTH {width:,} and HEIGHT {height:,} of the header do not multiply to its {count:,} points"
        )
    body, encoding = content[data_line.end() :], data_line[1].decode()
    if encoding == "ascii":
        return _parse_text(path, body, dtype, count)
    if encoding == "binary":
        return _parse_rows(path, body, dtype, count)
    if encoding == "binary_compressed":
        return _parse_columns(path, _decompress(path, body, count, count * dtype.itemsize), dtype, count)
    raise DataError(f"{path}: DATA {encoding} cannot be read; known are ascii, binary and binary_compressed")


def _parse_pcd_dtype(path: Path, header: dict[str, list[str]]) -> np.dtype:
    columns = [header.get(key, []) for key in ("FIELDS", "SIZE", "TYPE")]
    counts = header.get("COUNT", ["1"] * len(columns[0]))
    if not columns[0] or len({*map(len, columns), len(counts)}) != 1:
        raise DataError(f"{path}: FIELDS, SIZE, TYPE and COUNT of the header do not agree")
    parts: list[tuple[str, str, tuple[int, ...]]] = []
    for column, (name, size, kind, count) in enumerate(zip(*columns, counts, strict=True)):
        if kind + size not in PCD_TYPES:
            raise DataError(f"{path}: the field {name} of type {kind} and {size} bytes cannot be read")
        numbers = _parse_whole(path, "COUNT", count)
        unique = f"_{column}" if name == "_" else name  # "_" is padding, and there may be several
        parts.append((unique, PCD_TYPES[kind + size], () if numbers == 1 else (numbers,)))
    named_once([name for name, _, _ in parts], f"{path}: the field")
    try:
        return np.dtype(parts)
    except ValueError as error:
        raise DataError(f"{path}: FIELDS, SIZE, TYPE and COUNT of the header are impossible ({error})") from error


def _parse_text(
    path: Path, body: bytes, dtype: np.dtype, count: int, vertices_only: bool = True
) -> dict[str, np.ndarray]:
    numbers = sum(int(np.prod(dtype[name].shape)) for name in dtype.names or ())
    if len(body) + 1 < 2 * numbers * count:  # each number takes a digit and a separator, the last one only a digit
        raise DataError(f"{path}: {len(body):,} bytes cannot hold the {count:,} points that the header names")
    lines = body.split(b"\n", count)
    text = b" ".join(lines[:count])
    _check_rest(path, lines[count] if vertices_only and len(lines) > count else b"", count)
    try:
        if b"_" in text:
            raise ValueError("1_0 is a number in Python, not in a file")
        rows = np.array(text.split(), np.float64).reshape(count, numbers)
    except ValueError as error:
        raise DataError(f"{path}: the points are not {count} lines of {numbers} numbers; it is damaged") from error
    fields, start = {}, 0
    for name in dtype.names or ():
        size = int(np.prod(dtype[name].shape))
        fields[name] = rows[:, start] if size == 1 else rows[:, start : start + size]
        start += size
    return fields


def _parse_rows(
    path: Path, body: bytes, dtype: np.dtype, count: int, vertices_only: bool = True
) -> dict[str, np.ndarray]:
    if len(body) < count * dtype.itemsize:
        expected = f"{count * dtype.itemsize:,} for {count} points"
        raise DataError(f"{path}: {len(body):,} bytes follow the header instead of {expected}; it is damaged")
    _check_rest(path, body[count * dtype.itemsize :] if vertices_only else b"", count)
    table = np.frombuffer(body, dtype, count)
    return {name: table[name] for name in dtype.names or ()}


def _check_rest(path: Path, rest: bytes, count: int) -> None:
    """Raise DataError if anything but padding follows the last point: then the header does not describe the file."""
    if rest.strip(PADDING):
        raise DataError(f"{path}: {len(rest):,} bytes are left over after the {count:,} points that the header names")


def _parse_columns(path: Path, body: bytes, dtype: np.dtype, count: int) -> dict[str, np.ndarray]:
    if len(body) != count * dtype.itemsize:
        raise DataError(f"{path}: {len(body):,} bytes instead of {count * dtype.itemsize:,}; it is damaged")
    fields, start = {}, 0
    for name in dtype.names or ():
        base, shape = dtype[name].base, dtype[name].shape
        size = count * dtype[name].itemsize
        fields[name] = np.frombuffer(body[start : start + size], base).reshape(count, *shape)
        start += size
    return fields


def _decompress(path: Path, body: bytes, count: int, expected: int) -> bytes:
    if len(body) < 8:
        raise DataError(f"{path}: the file is cut short")
    packed, unpacked = np.frombuffer(body[:8], "<u4").tolist()
    if unpacked != expected or unpacked > MAX_LZF_RATIO * packed:
        raise DataError(
            f"{path}: {packed:,} compressed bytes state {unpacked:,} bytes; the header's points take {expected:,}, and "
            f"LZF compresses by no more than {MAX_LZF_RATIO}; it is damaged"
        )
    if len(body) < 8 + packed:
        raise DataError(f"{path}: {len(body) - 8:,} compressed bytes instead of {packed:,}; it is damaged")
    _check_rest(path, body[8 + packed :], count)
    result = np.empty(unpacked, np.uint8)
    if _undo_lzf(np.frombuffer(body, np.uint8, packed, 8), result) != unpacked:
        raise DataError(f"{path}: the compressed points are damaged")
    return result.tobytes()


@numba.njit
def _undo_lzf(packed: np.ndarray, result: np.ndarray) -> int:
    """Undo LZF compression; return the number of bytes written, -1 if the input is damaged."""
    read, written = 0, 0
    while read < len(packed):
        control = int(packed[read])
        read += 1
        if control < 32:  # this many bytes and one more follow as they are
            length = control + 1
            if read + length > len(packed) or written + length > len(result):
                return -1
            result[written : written + length] = packed[read : read + length]
            read += length
            written += length
            continue
        length = control >> 5  # less 2; 7: the next byte is added
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
        for offset in range(length + 2):  # byte by byte: bytes just written may be copied again
            result[written + offset] = result[source + offset]
        written += length + 2
    return written


def _parse_whole(path: Path, name: str, text: str) -> int:
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
