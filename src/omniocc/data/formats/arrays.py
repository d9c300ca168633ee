"""Arrays of npy and npz files, read only if they hold as much as their headers claim."""

import math
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np

from omniocc.io import check_regular, twice

LIMIT_BYTES = 2**29
"""Largest size of the arrays that are read from one npz file: a compressed one may be a thousand times smaller."""


def npz_arrays(file: Path | BinaryIO, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Return those of the named arrays that an npz file has; None: all.

    Raises:
        ValueError: if a name stands twice, if they are larger than `LIMIT_BYTES`, or as `npy_array`.
        Exception: others of `zipfile` and numpy for damaged files.
    """
    if isinstance(file, Path):
        check_regular(file)
    with zipfile.ZipFile(file) as archive:
        stored = [info.filename.removesuffix(".npy") for info in archive.infolist()]
        if name := twice(stored):
            raise ValueError(f"the array '{name}' stands twice")
        found = dict(zip(stored, archive.infolist(), strict=True))
        wanted = {name: found[name] for name in (found if names is None else names) if name in found}
        total = sum(info.file_size for info in wanted.values())
        if total > LIMIT_BYTES:
            raise ValueError(f"its arrays unpack to {total:,} bytes, at most {LIMIT_BYTES:,} are read")
        arrays = {}
        for name, info in wanted.items():
            with archive.open(info) as member:
                arrays[name] = npy_array(member, info.file_size)
        return arrays


def npy_array(file: IO[bytes], size: int) -> np.ndarray:
    """Return the array of an npy file of `size` bytes, open at its beginning.

    Raises:
        ValueError: if its header claims more than the file holds, or objects of Python.
    """
    read_header = np.lib.format.read_array_header_1_0
    if np.lib.format.read_magic(file) != (1, 0):
        read_header = np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    claimed, rest = math.prod(shape) * dtype.itemsize, size - file.tell()
    if dtype.hasobject:
        raise ValueError(f"it holds objects of Python ({dtype}), which are not read")
    if min(shape, default=0) < 0 or claimed > rest:
        raise ValueError(f"its header claims {shape} of {dtype}, {claimed:,} bytes, but {rest:,} follow")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)
