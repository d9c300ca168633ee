"""Files of runs, read only: nothing is written, locked or created."""

import os
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from omniocc.io import read_yaml
from omniocc.runs.curves import Curve, curve_files, read_curves

LOCKS = Path("/proc/locks")
Identity = tuple[int, int, int]
"""A file: device (major, minor) and inode."""


def modified_s(path: Path) -> float:
    """Return the time of day at which a file or folder last changed, s; 0 if there is none."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def curves_of(folder: Path) -> dict[str, Curve]:
    """Return the curves of a run, read again only when a file has changed; errors as `read_curves`."""
    stats = [(path, path.stat()) for path in curve_files(folder)]
    return _curves(folder, tuple((str(path), stat.st_mtime_ns, stat.st_size) for path, stat in stats))


@lru_cache(maxsize=256)
def _curves(folder: Path, stamps: tuple[tuple[str, int, int], ...]) -> dict[str, Curve]:
    del stamps  # the key of the cache: other files, other curves
    return read_curves(folder)


def config_of(path: Path) -> Mapping[str, Any]:
    """Return the configuration of a run; empty if there is none, or it is not whole."""
    return _config(path, modified_s(path))


@lru_cache(maxsize=256)
def _config(path: Path, modified: float) -> Mapping[str, Any]:
    del modified
    try:
        config = read_yaml(path)
    except OSError:
        return {}
    return config if isinstance(config, dict) else {}


def held_locks(table: Path = LOCKS) -> frozenset[Identity]:
    """Return the files that processes of this machine hold locks of, from Linux's `/proc/locks`.

    To take the lock instead could make a run that starts just then fail. Elsewhere the result is empty.
    """
    try:
        words = table.read_text("utf-8").split()
    except OSError:
        return frozenset()
    parts = [word.split(":") for word in words if word.count(":") == 2]
    return frozenset((int(major, 16), int(minor, 16), int(inode)) for major, minor, inode in parts)


def identity(path: Path) -> Identity | None:
    """Return which file a path leads to; None if there is none."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return os.major(stat.st_dev), os.minor(stat.st_dev), stat.st_ino
