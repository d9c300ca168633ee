"""Write files atomically: whole or not at all; read YAML fast."""

import contextlib
import errno
import glob
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import yaml

from omniocc.errors import DataError

YAML = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Loader of YAML of plain data: that of the C library where it is there, which takes an eighth of the time."""

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space",
    errno.EFBIG: "files may not grow that large here: raise the limit (ulimit -f)",
    errno.EDQUOT: "the disk quota is used up: free some space",
    errno.EROFS: "the folder is read-only: choose another one (paths.data=... or paths.runs=...)",
    errno.EACCES: "the folder may not be written to: choose another one (paths.data=... or paths.runs=...)",
    errno.EPERM: "the folder may not be written to: choose another one (paths.data=... or paths.runs=...)",
    errno.EMFILE: "too many open files: raise the limit (ulimit -n)",
}


def atomic_write(path: Path, content: bytes | memoryview | str, previous: Path | None = None) -> None:
    """Write a file as `atomic_file` does; `content` is all of it, text is encoded as UTF-8.

    Raises:
        DataError: when the file cannot be written.
    """
    data = content.encode() if isinstance(content, str) else content
    with atomic_file(path, previous, len(data)) as file:
        file.write(data)


@contextlib.contextmanager
def atomic_file(
    path: Path, previous: Path | None = None, needed_bytes: int | None = None, flush: bool = True
) -> Iterator[BinaryIO]:
    """Give a file to write to under a temporary name beside `path`; then flush it to the disk and rename it.

    Readers see the old file or the new one, never a part, whenever the process or the machine stops. The temporary file
    is a new one with a random name: nothing that lies there already, such as a link, is written to.

    Args:
        path: the file; its folder is made if missing.
        previous: new name of the old file in the same folder; None does not keep it. It is renamed just
            before the new file, so that after a stop between the two only this name exists.
        needed_bytes: size of the content, if known, for the message of a full disk.
        flush: whether the file has to outlive a power cut, which takes time.

    Raises:
        DataError: when the file cannot be written; the old file is there, under its own name or that of `previous`, and
            nothing temporary is left.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = _new_file_beside(path)
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            if flush:
                os.fsync(descriptor)
        if previous is not None and path.exists():
            os.replace(path, previous)
        os.replace(temporary, path)
        if flush:
            _flush_folder(path.parent)
    except BaseException as error:
        if temporary is not None:
            with contextlib.suppress(OSError):  # the error that counts is the one before
                temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and not isinstance(error, DataError):
            raise cannot_write(path, error, needed_bytes) from error
        raise


def _new_file_beside(path: Path) -> tuple[int, Path]:
    """Return the descriptor and name of a new file in the same folder, with the mode that `open` would give it."""
    while True:
        temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
        with contextlib.suppress(FileExistsError):
            return os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666), temporary


def remove_leftovers(path: Path) -> None:
    """Remove temporary files that killed processes left beside `path`; only its single writing process may call it."""
    for leftover in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        leftover.unlink(missing_ok=True)


def check_regular(path: Path) -> None:
    """Check that a path is that of a file with content of its own.

    To read a pipe or a device in its place would wait for ever, or never end.

    Raises:
        FileNotFoundError: when there is nothing, or a link to nothing.
        DataError: for anything else, such as a pipe, a folder, or links that lead in a circle.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from error
    if not stat.S_ISREG(mode):
        kind = next((name for test, name in _KINDS if test(mode)), "special file")
        raise DataError(f"{path} cannot be read: it is a {kind}, not a file")


_KINDS = ((stat.S_ISDIR, "folder"), (stat.S_ISFIFO, "pipe"), (stat.S_ISCHR, "device"), (stat.S_ISBLK, "device"))


def cannot_write(path: Path, error: OSError, needed_bytes: int | None = None) -> DataError:
    """Return the error to raise when writing to a file or folder failed; complete files stay valid.

    The size of the file, if known, is named with the free space when the disk is full.
    """
    reason = _REMEDIES.get(error.errno or 0, f"{error.strerror or error}")
    if error.errno == errno.ENOSPC and needed_bytes is not None:
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        free_bytes = shutil.disk_usage(folder).free
        reason += f" ({needed_bytes:,} bytes are needed, {free_bytes:,} are free)"
    remedy = ", then run the same command again; it continues where it stopped" if error.errno in _REMEDIES else ""
    return DataError(f"cannot write {path}: {reason}{remedy}")


def _flush_folder(folder: Path) -> None:
    """Flush a folder to the disk, so that renames in it survive a power cut, where the file system supports it."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot flush folders
            raise
    finally:
        os.close(descriptor)
