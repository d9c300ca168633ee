"""Write files atomically: whole or not at all; check names that become those of files; read YAML fast."""

import contextlib
import errno
import os
import shutil
from pathlib import Path

import yaml

from omniocc.errors import DataError, UserError

YAML = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Loader of YAML of plain data: that of the C library where it is there, which takes an eighth of the time."""

NAME_BYTES = 100
"""Most bytes of a name; those of files and folders, which add to it, may have 255."""
NOT_IN_NAMES = frozenset('/\\<>:"|?*')
"""Characters that separate folders, or that some file system, HTML or a Markdown table takes for its own."""

_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space",
    errno.EFBIG: "files may not grow that large here: raise the limit (ulimit -f)",
    errno.EDQUOT: "the disk quota is used up: free some space",
    errno.EROFS: "the folder is read-only: choose another one (paths.data=... or paths.runs=...)",
    errno.EACCES: "the folder may not be written to: choose another one (paths.data=... or paths.runs=...)",
    errno.EPERM: "the folder may not be written to: choose another one (paths.data=... or paths.runs=...)",
    errno.EMFILE: "too many open files: raise the limit (ulimit -n)",
}


def checked_name(what: str, name: object) -> str:
    """Return a name that becomes a part of the path of a file or folder.

    Raises:
        UserError: naming `what` has the name, if it could lead out of its folder, be hidden, or not be written.
    """
    if isinstance(name, str) and _can_be_in_paths(name):
        return name
    shown = repr(name) if len(repr(name)) <= NAME_BYTES else f"{repr(name)[:NAME_BYTES]}..."
    raise UserError(
        f"{what} is {shown}; files are called by it: 1 to {NAME_BYTES} printable characters, none of "
        f"{' '.join(sorted(NOT_IN_NAMES))}, no point first, no space first or last"
    )


def _can_be_in_paths(name: str) -> bool:
    sized = name.isprintable() and 0 < len(name.encode()) <= NAME_BYTES
    return sized and not set(name) & NOT_IN_NAMES and name.strip() == name and not name.startswith(".")


def atomic_write(path: Path, content: bytes | memoryview | str, previous: Path | None = None) -> None:
    """Write a file under a temporary name beside it, flush it to the disk, then rename it.

    Readers see the old file or the new one, never a part, whenever the process or the machine stops.

    Args:
        path: the file; its folder is made if missing.
        content: all of it; text is encoded as UTF-8.
        previous: new name of the old file in the same folder; None does not keep it. It is renamed just
            before the new file, so that after a stop between the two only this name exists.

    Raises:
        DataError: when the file cannot be written; the old file is there, under its own name or that of `previous`, and
            nothing temporary is left.
    """
    data = content.encode() if isinstance(content, str) else content
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if previous is not None and path.exists():
            os.replace(path, previous)
        os.replace(temporary, path)
        _flush_folder(path.parent)
    except BaseException as error:
        with contextlib.suppress(OSError):  # the error that counts is the one before
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise cannot_write(path, error, len(data)) from error
        raise


def remove_leftovers(path: Path) -> None:
    """Remove temporary files that killed processes left beside `path`; only its single writing process may call it."""
    for leftover in path.parent.glob(f".{path.name}.*.tmp"):
        leftover.unlink(missing_ok=True)


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
