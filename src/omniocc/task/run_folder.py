"""Where a run lives: a folder named by its configuration, so that the same command finds it again."""

import hashlib
import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from omniocc.errors import UserError

LAST, BEST, METRICS = "last.ckpt", "best.ckpt", "metrics.json"
VOLATILE = ("resume", "paths", "logger", "pictures", "checkpoint_every_n_steps")
"""Root keys that do not change what a run computes."""


@dataclass(frozen=True)
class RunFolder:
    """A run's folder, locked by this process; `checkpoint` is where to continue, None at the start."""

    path: Path
    checkpoint: Path | None
    lock: FileLock

    @property
    def finished(self) -> bool:
        """Whether the run has been trained and tested."""
        return (self.path / METRICS).exists()


def run_hash(config: dict[str, Any], data_fingerprint: str) -> str:
    """Eight hex digits of everything that decides a run's result."""
    kept = {key: value for key, value in config.items() if key not in VOLATILE}
    text = json.dumps([kept, data_fingerprint], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def open_run(runs: Path, name: str, digest: str, resume: str) -> RunFolder:
    """Find or make the folder of a run and lock it.

    Args:
        runs: folder of all runs.
        name: human part of the folder's name.
        digest: `run_hash` of the run.
        resume: `auto` continues the folder of the same hash; `never` takes a fresh one beside it; anything else is a checkpoint to go on from.

    Raises:
        UserError: when another process works in the folder.
        FileNotFoundError: when the checkpoint to go on from is not there.
    """
    path = runs / f"{name}-{digest}"
    number = 2
    while resume == "never" and path.exists():
        path, number = runs / f"{name}-{digest}-{number}", number + 1
    path.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise UserError(f"another process is working in {path}; wait for it, or give this run another name=...") from None
    checkpoint = path / LAST
    if resume not in ("auto", "never"):
        checkpoint = Path(resume)
        if not checkpoint.is_file():
            raise FileNotFoundError(f"resume={resume}: there is no such checkpoint")
    return RunFolder(path, checkpoint if checkpoint.exists() else None, lock)


def write_whole(path: Path, text: str) -> None:
    """Write a file that is either the old one or the new one, never a part."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text)
    os.replace(partial, path)


def git_commit() -> str:
    """Commit of the source tree, `+` when it has changes; `unknown` outside a repository."""
    here = Path(__file__).parent
    try:
        show = subprocess.run(["git", "describe", "--always", "--dirty=+"], cwd=here, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return show.stdout.strip()
