"""Checkpoint files: written atomically, with the previous one kept, and checked when read."""

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import torch

from omniocc.errors import FAULTS, UserError
from omniocc.io import atomic_write, remove_leftovers
from omniocc.runs.weights import BEST, LAST, shipped

UNREADABLE = (*FAULTS, pickle.UnpicklingError, OSError, MemoryError)
"""Errors of `zipfile` and `torch.load` for files that are damaged or of another kind."""


def previous_of(path: Path) -> Path:
    """Return the name of the previous checkpoint of `path`."""
    return path.with_name(f"{path.stem}.previous{path.suffix}")


def write_checkpoint(content: dict[str, Any], path: Path, previous: Path | None = None) -> None:
    """Write a checkpoint atomically, and make its folder if missing; only one process may write to `path`.

    The old file is renamed to `previous`; None does not keep it.

    Raises:
        DataError: when the disk refuses; the old file is untouched.
    """
    buffer = io.BytesIO()
    torch.save(content, buffer)
    remove_leftovers(path)
    atomic_write(path, buffer.getbuffer(), previous)


def no_checkpoint_message(path: Path) -> str:
    """Return the message for a path that is no file."""
    if path.is_dir():
        return f"{path}: the folder has neither {BEST} nor {LAST} (is it a run of train.py?)"
    names = ", ".join(shipped())
    hint = f"; the names of weights that come with the package are {names}" if names else ""
    return f"{path}: there is no such checkpoint{hint}"


def read_checkpoint(path: Path, map_location: Any = "cpu", weights_only: bool = True) -> dict[str, Any]:
    """Return the content of a checkpoint after comparing it with its checksums, which `torch.load` does not do.

    `map_location` is that of `torch.load`; `weights_only` allows only tensors and plain values.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when it is damaged or not a checkpoint.
    """
    if not path.is_file():
        raise FileNotFoundError(no_checkpoint_message(path))
    try:
        with zipfile.ZipFile(path) as members:
            whole, size = sum(member.file_size for member in members.infolist()), path.stat().st_size
            if whole > size:  # torch.save compresses nothing
                raise zipfile.BadZipFile(f"it has {size:,} bytes, but its parts state {whole:,}")
            if (damaged := members.testzip()) is not None:
                raise zipfile.BadZipFile(f"the checksum of {damaged} differs")
        content = torch.load(path, map_location=map_location, weights_only=weights_only)
        if not isinstance(content, dict) or not {"config", "state_dict"} <= content.keys():
            raise ValueError("it has no config or no state_dict")
    except UNREADABLE as error:
        raise UserError(
            f"{path} is not a checkpoint of this platform, or it is damaged ({_brief(error)}). {_remedy(path)}"
        ) from error
    return content


def _remedy(path: Path) -> str:
    """Return what to do about an unreadable checkpoint; only files named as those of a run are to be moved."""
    if path.name not in (BEST, LAST, previous_of(Path(LAST)).name):
        return "Those of a run are runs/<run>/best.ckpt and last.ckpt"
    moved = path if path.name == BEST else path.parent
    return f"If it is one of a run here, move {moved} elsewhere and give the run's command again"


def resumable(path: Path) -> tuple[Path | None, str | None]:
    """Return the checkpoint to resume from, `path` or the previous one if that cannot be read, and a message.

    The checkpoint is None where there is none yet. The message is None unless the previous one has to be used.

    Raises:
        UserError: when there are checkpoints and none can be read.
    """
    previous = previous_of(path)
    try:
        read_checkpoint(path)
        return path, None
    except FileNotFoundError as error:
        if not previous.is_file():
            return None, None
        reason: Exception = error
    except UserError as error:
        if not previous.is_file():
            raise
        reason = error.__cause__ if isinstance(error.__cause__, Exception) else error
    try:
        read_checkpoint(previous)
    except UserError as error:
        raise UserError(
            f"neither {path} nor {previous.name} can be read, the last save was cut off and the one before is damaged "
            f"({_brief(reason)}). To train again from the first step, move {path.parent} elsewhere and give the run's "
            "command again"
        ) from error
    return previous, f"{path} cannot be read ({_brief(reason)}); goes on from the one before, {previous.name}"


def _brief(error: Exception) -> str:
    return str(error).split(". ")[0].strip() or type(error).__name__
