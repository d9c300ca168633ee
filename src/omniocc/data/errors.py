"""The one error of everything on disk, and writing a file whole or not at all."""

import errno
import os
from pathlib import Path


class DataError(OSError):
    """Recorded data is missing, damaged or cannot be written. The message names the path and the remedy."""


_REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space",
    errno.EFBIG: "files may not grow that large here: raise the limit (ulimit -f)",
    errno.EDQUOT: "the disk quota is used up: free some space",
    errno.EROFS: "the folder is read-only: choose another one (paths.data=...)",
    errno.EACCES: "the folder may not be written to: choose another one (paths.data=...)",
    errno.EPERM: "the folder may not be written to: choose another one (paths.data=...)",
    errno.EMFILE: "too many open files: raise the limit (ulimit -n)",
}


def cannot_write(path: Path, error: OSError) -> DataError:
    """The error to raise when writing to `path` failed; what was complete before stays valid."""
    reason = _REMEDIES.get(error.errno or 0, f"{error.strerror or error}")
    return DataError(f"cannot write {path}: {reason}, then run the same command again; it continues where it stopped")


def write_whole(path: Path, content: bytes | str) -> None:
    """Write bytes or a text to a temporary name, then rename: readers see the old file or the new one, never a part.

    Raises:
        DataError: when the disk refuses.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise cannot_write(path, error) from error
