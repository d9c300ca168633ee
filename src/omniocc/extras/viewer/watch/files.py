"""Files of runs, read only: nothing is written, locked or created."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from omniocc.runs.curves import Curve, curve_files, read_curves
from omniocc.runs.renamed import read_config
from omniocc.runs.results import METRICS, load_results

LOCKS = Path("/proc/locks")
Identity = tuple[int, int, int]
"""A file: device (major, minor) and inode."""
Stamps = tuple[tuple[str, int, int], ...]
"""Names of files, the time of their last change, ns, and their sizes, bytes."""
CONFIG = "config.yaml"


def modified_s(path: Path) -> float:
    """Return the time at which a file or folder last changed, s since 1970; 0 if there is none."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


_read: dict[tuple[Callable[[Path], Any], Path], tuple[Stamps, Any, str]] = {}
"""What readers have made of the files of every run, which a page asks for every few seconds, and what was wrong."""


def read_again(reader: Callable[[Path], Any], folder: Path, paths: Sequence[Path]) -> tuple[Any, str]:
    """Return what a reader makes of a run's folder, and what is wrong; it reads again only when a file has changed.

    Args:
        reader: raises OSError or ValueError naming the file, when it is damaged; the result is then None.
        folder: of the run.
        paths: files that it reads.
    """
    stats = [path.stat() if path.exists() else path.lstat() for path in paths]
    stamps = tuple((str(path), stat.st_mtime_ns, stat.st_size) for path, stat in zip(paths, stats, strict=True))
    known = _read.get((reader, folder))
    if known is None or known[0] != stamps:
        try:
            known = stamps, reader(folder), ""
        except (OSError, ValueError) as error:
            known = stamps, None, f"left out: {error}"
        _read[reader, folder] = known
    return known[1:]


def curves_of(folder: Path) -> tuple[Mapping[str, Curve], str]:
    """Return the curves of a run, none where a file is damaged, and what is wrong."""
    curves, problem = read_again(read_curves, folder, curve_files(folder))
    return curves or {}, problem


def config_of(folder: Path) -> tuple[Mapping[str, Any], str]:
    """Return the configuration of a run, empty if there is none or it is damaged, and what is wrong."""
    path = folder / CONFIG
    config, problem = read_again(_config, folder, [path]) if os.path.lexists(path) else ({}, "")
    return config or {}, problem


def _config(folder: Path) -> Mapping[str, Any]:
    return read_config(folder / CONFIG)


def problem_of_results(folder: Path) -> str:
    """Return what is wrong with the figures of a finished run; empty where they are sound, or not there yet."""
    path = folder / METRICS
    return read_again(load_results, folder, [path])[1] if os.path.lexists(path) else ""


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
