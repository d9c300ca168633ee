"""The files of one folder, on this disk or in an object store (a URL, see `omniocc.urls`), read by byte range."""

import os
import sys
import time
from base64 import b64encode
from collections.abc import Callable, Sequence
from netrc import NetrcParseError, netrc
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import fsspec
from aiohttp import ClientResponseError
from fsspec.implementations.local import LocalFileSystem

from omniocc.errors import DataError, installing
from omniocc.io import check_regular, parse_json
from omniocc.urls import check_url

T = TypeVar("T")
BLOCK_BYTES = 2**22
LIMIT_BYTES = 2**27
"""Largest size of files that are read whole; an index of a scene of three hours at 10 Hz has half of it."""
JOINED_GAP_BYTES = 4096
"""Ranges nearer to one another than this are read as one: headers between members cost less than another request."""
RETRY_FOR_S = 300.0
"""How long a store that has answered before is asked again when it does not answer: minutes, as an outage may last. Of
fsspec, http asks once, and s3fs five times within two seconds."""
LONGEST_PAUSE_S = 15.0
LASTING = (FileNotFoundError, PermissionError, NotADirectoryError, IsADirectoryError, ValueError, TypeError)
"""Errors that another request will not mend."""
S3 = ("s3", "s3a")
PACKAGES = {"gs": "gcsfs", "gcs": "gcsfs", "abfs": "adlfs", "az": "adlfs"}
"""What to install for other kinds of store."""
_answered: set[str] = set()
"""Stores that this process has reached."""


class Files:
    """The files of a folder: a path on this disk, or a URL.

    Every method raises FileNotFoundError for a missing file, and DataError for what is no file, such as a pipe. The
    connection to an object store is made by the process that creates the object. A store that answered this process
    before and does not answer now is asked again for `RETRY_FOR_S`, which a line on stderr says.

    Raises:
        DataError: when the package for this kind of URL is not installed.
        UserError: as `is_url`.
    """

    def __init__(self, folder: Path | str):
        self.folder = str(folder)
        local: tuple[Any, str] = LocalFileSystem(), str(Path(folder).absolute())
        self._fs, self._root = _file_system(self.folder) if is_url(folder) else local

    def where(self, name: str) -> str:
        """Return path or URL of a file, for messages."""
        return f"{self.folder}/{name}"

    def size(self, name: str) -> int:
        """Return the length in bytes."""
        path = self._path(name)
        return self._asked(lambda: self._fs.info(path)["size"], name)

    def open(self, name: str) -> Any:
        """Return the open file, binary, at its beginning."""
        return self._fs.open(self._path(name), "rb", block_size=BLOCK_BYTES)

    def read(self, name: str, limit_bytes: int = LIMIT_BYTES) -> bytes:
        """Return the whole content; raise DataError if it is longer than the limit."""
        path = self._path(name)
        content = self._asked(lambda: self._fs.cat_file(path, start=0, end=limit_bytes + 1), name)
        if len(content) > limit_bytes:
            raise DataError(
                f"{self.where(name)}: the file has more than {limit_bytes:,} bytes, which are expected at most"
            )
        return content

    def ranges(self, name: str, spans: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return the bytes from `begin` up to `end` of each (begin, end); fewer where the file ends early.

        All requests to an object store are sent at once.

        Raises:
            OSError: when a server does not support byte ranges and sends more.
        """
        begins, ends = [begin for begin, _ in spans], [end for _, end in spans]
        paths = [self._path(name)] * len(spans)
        parts = self._asked(lambda: self._fs.cat_ranges(paths, begins, ends, on_error="raise"), name)
        for (begin, end), part in zip(spans, parts, strict=True):
            if len(part) > end - begin:
                raise OSError(f"the server does not support byte ranges: {len(part)} bytes instead of {end - begin}")
        return parts

    def folders(self) -> list[str]:
        """Return the names of the folders in this one, sorted."""
        rows = self._asked(lambda: self._fs.ls(self._root, detail=True), "")
        links = [row["name"] for row in rows if row.get("islink") and self._fs.isdir(row["name"])]
        found = {row["name"] for row in rows if row["type"] == "directory"}.union(links)
        return sorted(name.rstrip("/").rsplit("/", 1)[-1] for name in found)

    def _path(self, name: str) -> str:
        path = f"{self._root.rstrip('/')}/{name}"
        if isinstance(self._fs, LocalFileSystem):
            check_regular(Path(path))
        return path

    def _asked(self, request: Callable[[], T], name: str) -> T:
        return request_with_retries(request, self.where(name)) if is_url(self.folder) else request()


def _file_system(url: str) -> tuple[Any, str]:
    try:
        return fsspec.core.url_to_fs(url, **_login(url))
    except ImportError as error:
        kind = url.partition("://")[0]
        other = f"pip install {PACKAGES[kind]}" if kind in PACKAGES else str(error)
        remedy = installing("s3") if kind in S3 else other
        raise DataError(f"{url}: reading {kind}:// needs a package that is not installed: {remedy}") from error


def _login(url: str) -> dict[str, Any]:
    """Return the options with user and password of an http server from the user's netrc file, if it has them."""
    parts, path = urlsplit(url), Path(os.environ.get("NETRC") or Path.home() / ".netrc")
    if parts.scheme not in ("http", "https") or not path.is_file():
        return {}
    try:
        found = netrc(path).authenticators(parts.hostname or "")
    except (NetrcParseError, OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: the file with passwords for {parts.hostname} cannot be read ({error})") from error
    if found is None:
        return {}
    login = b64encode(f"{found[0]}:{found[2]}".encode()).decode()
    return {"headers": {"Authorization": f"Basic {login}"}}  # of requests: not sent on to another host


def request_with_retries(request: Callable[[], T], url: str) -> T:
    """Return the answer of a store to a request; ask again for `RETRY_FOR_S` if it answered this process before.

    Args:
        request: asks once.
        url: of the file, for the message that says that the store is asked again.

    Raises:
        Exception: what the last request raised.
    """
    store = "/".join(url.split("/")[:3])
    begin_s, pause_s, told = time.monotonic(), 1.0, False
    while True:
        try:
            answer = request()
        except Exception as error:  # each kind of store has errors of its own
            left_s = begin_s + RETRY_FOR_S - time.monotonic()
            if store not in _answered or is_permanent(error) or left_s <= 0:
                raise
            if not told:
                print(f"{url}: no answer ({named(error)}); trying again for {left_s:.0f} s", file=sys.stderr)
            told = True
            time.sleep(min(pause_s, left_s))
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        else:
            _answered.add(store)
            if told:
                print(f"{url}: answers again after {time.monotonic() - begin_s:.0f} s", file=sys.stderr)
            return answer


def is_permanent(error: Exception) -> bool:
    """Return whether asking again cannot help: the file is missing, access is denied, the request is wrong."""
    if isinstance(error, ClientResponseError):
        return 400 <= error.status < 500 and error.status not in (408, 429)
    return isinstance(error, LASTING)


def named(error: Exception) -> str:
    """Return kind and text of an error in one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def is_url(place: str | os.PathLike[str]) -> bool:
    """Return whether a place is a URL and not a path.

    Raises:
        UserError: for a URL with credentials, or of a protocol that is not read.
    """
    if not isinstance(place, str) or "://" not in place:
        return False
    check_url(place)
    return True


def list_folders(root: Path | str, member: str) -> list[str]:
    """Return the names of the folders in `root` that hold a file `member`, sorted; those with a suffix are left out.

    Raises:
        DataError: when the folder does not exist or cannot be listed.
        UserError: as `is_url`.
    """
    files = Files(root)
    try:
        return [name for name in files.folders() if "." not in name and holds(f"{root}/{name}", member)]
    except FileNotFoundError as error:
        raise DataError(f"{root}: there is no such folder") from error
    except Exception as error:  # each kind of store has errors of its own
        raise DataError(f"{root}: its folders cannot be listed: {named(error)}") from error


def holds(folder: Path | str, name: str) -> bool:
    """Return whether a folder has a file of this name that is not empty."""
    try:
        return Files(folder).size(name) > 0
    except FileNotFoundError:
        return False


def read_json(root: Path | str, name: str, remedy: str) -> Any:
    """Return the content of a JSON file; raise DataError when it cannot be read; the message ends with the remedy."""
    files = Files(root)
    try:
        return parse_json(files.read(name))
    except FileNotFoundError as error:
        raise DataError(f"{files.where(name)}: the file is missing; {remedy}") from error
    except Exception as error:  # each kind of store has errors of its own
        raise DataError(f"{files.where(name)}: cannot be read: {named(error)}; {remedy}") from error


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
