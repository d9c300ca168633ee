"""The files of one folder, on this disk or in an object store (any URL that fsspec understands), read by byte range."""

import json
import os
from collections.abc import Sequence
from io import BufferedReader
from pathlib import Path
from typing import Any

import fsspec

from omniocc.errors import DataError

BLOCK_BYTES = 2**22
JOINED_GAP_BYTES = 4096
"""Ranges nearer to one another than this are read as one: headers between members cost less than another request."""


class LocalFiles:
    """The files of a folder on this disk; every method raises FileNotFoundError for a missing file."""

    def __init__(self, folder: Path):
        self.folder = folder

    def where(self, name: str) -> str:
        """Return path or URL of a file, for messages."""
        return str(self.folder / name)

    def size(self, name: str) -> int:
        """Return the length in bytes."""
        return (self.folder / name).stat().st_size

    def open(self, name: str) -> BufferedReader:
        """Return the open file, binary, at its beginning."""
        return (self.folder / name).open("rb")

    def ranges(self, name: str, spans: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return the bytes from `begin` up to `end` of each (begin, end); fewer where the file ends early."""
        parts = []
        with self.open(name) as file:
            for begin, end in spans:
                file.seek(begin)
                parts.append(file.read(end - begin))
        return parts

    def folders(self) -> list[str]:
        """Return the names of the folders in this one, sorted."""
        return sorted(path.name for path in self.folder.iterdir() if path.is_dir())


class RemoteFiles:
    """The same for a folder behind a URL; the connection is made by the process that creates the object."""

    def __init__(self, url: str):
        self.url = url
        self._fs, self._root = fsspec.core.url_to_fs(url)

    def where(self, name: str) -> str:  # noqa: D102
        return f"{self.url}/{name}"

    def size(self, name: str) -> int:  # noqa: D102
        return int(self._fs.size(self._path(name)))

    def open(self, name: str) -> Any:  # noqa: D102
        return self._fs.open(self._path(name), "rb", block_size=BLOCK_BYTES)

    def ranges(self, name: str, spans: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return bytes as `LocalFiles.ranges` does, with all requests at once.

        Raises:
            OSError: when a server does not support byte ranges and sends more.
        """
        begins, ends = [begin for begin, _ in spans], [end for _, end in spans]
        parts = self._fs.cat_ranges([self._path(name)] * len(spans), begins, ends, on_error="raise")
        for (begin, end), part in zip(spans, parts, strict=True):
            if len(part) > end - begin:
                raise OSError(f"the server does not support byte ranges: {len(part)} bytes instead of {end - begin}")
        return parts

    def folders(self) -> list[str]:  # noqa: D102
        rows = self._fs.ls(self._root, detail=True)
        return sorted(row["name"].rstrip("/").rsplit("/", 1)[-1] for row in rows if row["type"] == "directory")

    def _path(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}"


Files = LocalFiles | RemoteFiles


def is_url(place: str | os.PathLike[str]) -> bool:
    """Return whether a place is a URL and not a path."""
    return isinstance(place, str) and "://" in place


def open_folder(folder: Path | str) -> Files:
    """Return the files of a folder: a URL, or a path on this disk."""
    return RemoteFiles(str(folder)) if is_url(folder) else LocalFiles(Path(folder))


def list_folders(root: Path | str, member: str) -> list[str]:
    """Return the names of the folders in `root` that hold a file `member`, sorted; those with a suffix are left out.

    Raises:
        DataError: when the folder does not exist or cannot be listed.
    """
    try:
        return [name for name in open_folder(root).folders() if "." not in name and holds(f"{root}/{name}", member)]
    except FileNotFoundError as error:
        raise DataError(f"{root}: there is no such folder") from error
    except Exception as error:  # each kind of store has errors of its own
        raise DataError(f"{root}: its folders cannot be listed: {type(error).__name__}: {error}") from error


def holds(folder: Path | str, name: str) -> bool:
    """Return whether a folder has a file of this name that is not empty."""
    try:
        return open_folder(folder).size(name) > 0
    except FileNotFoundError:
        return False


def read_json(root: Path | str, name: str, remedy: str) -> Any:
    """Return the content of a JSON file; raise DataError when it cannot be read; the message ends with the remedy."""
    files = open_folder(root)
    try:
        with files.open(name) as file:
            return json.load(file)
    except FileNotFoundError as error:
        raise DataError(f"{files.where(name)}: the file is missing; {remedy}") from error
    except Exception as error:  # each kind of store has errors of its own
        raise DataError(f"{files.where(name)}: cannot be read: {type(error).__name__}: {error}; {remedy}") from error


def read_members(files: Files, name: str, offsets: Sequence[int], sizes: Sequence[int]) -> list[bytes]:
    """Read the parts of a file that begin at `offsets` and are `sizes` long; near ones are read together.

    Returns:
        One part per offset; shorter where the file ends early.
    """
    spans: list[tuple[int, int]] = []
    for begin, size in sorted(zip(offsets, sizes, strict=True)):
        if spans and begin - spans[-1][1] <= JOINED_GAP_BYTES:
            spans[-1] = spans[-1][0], max(spans[-1][1], begin + size)
        else:
            spans.append((begin, begin + size))
    parts = list(zip(spans, files.ranges(name, spans), strict=True))
    return [_cut(parts, begin, size) for begin, size in zip(offsets, sizes, strict=True)]


def _cut(parts: Sequence[tuple[tuple[int, int], bytes]], begin: int, size: int) -> bytes:
    (first, _), part = next(item for item in parts if item[0][0] <= begin <= item[0][1])
    return part[begin - first : begin - first + size]
