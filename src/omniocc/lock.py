"""Locks on files, by which processes agree who works in a folder; the only place that knows how they are made."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, SoftFileLock, Timeout

from omniocc.errors import DataError
from omniocc.io import cannot_write

BEGUN_S = 3.0
"""Time within which a process writes its number into a lock that is a mere file."""


class Held(Exception):  # noqa: N818
    """Another process holds a lock.

    Attributes:
        remedy: a clause on what to do if that process is gone; empty where the system releases its locks.
    """

    def __init__(self, remedy: str = ""):
        super().__init__(remedy)
        self.remedy = remedy


def acquire(path: Path, wait: bool = False) -> FileLock:
    """Lock a file, which is made with its folder, and return the lock; the system releases it when the process ends.

    On a file system without `flock` this raises DataError or, by filelock's version, the file is the lock as long as
    it exists. Then a process that was killed on another machine leaves the file behind.

    Raises:
        Held: when another process holds the lock and `wait` is False.
        DataError: naming the file and what to do, when it cannot be written or locked, or nobody knows its owner.
    """
    lock = FileLock(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            remedy = _await_owner(lock, path) if isinstance(lock, SoftFileLock) else ""
            if not lock.is_locked and not wait:
                raise Held(remedy) from None
            if remedy:
                print(f"waits for another process that holds {path}{remedy}", flush=True)
            if not lock.is_locked:
                lock.acquire()
    except NotImplementedError as error:  # filelock before 3.20
        raise cannot_write(path, OSError(errno.ENOLCK, str(error))) from error
    except DataError:
        raise
    except OSError as error:
        raise cannot_write(path, error) from error
    return lock


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file inside this block; wait for it. Errors are those of `acquire`."""
    lock = acquire(path, wait=True)
    try:
        yield
    finally:
        lock.release()


def _await_owner(lock: SoftFileLock, path: Path) -> str:
    """Return what to do about a file that another process may have left; empty if it is ours meanwhile.

    Raises:
        DataError: when the file does not say which process made it, since it was made on a file system with `flock`.
    """
    if lock.pid is None:  # perhaps it is being written
        with suppress(Timeout):
            lock.acquire(timeout=BEGUN_S)
            return ""
    if lock.pid is None:
        raise DataError(
            f"{path} locks this folder, whose file system has no flock, and names no process: remove the file if no "
            "other process works in the folder"
        )
    return f"; if process {lock.pid} does not run any more, remove {path}"
