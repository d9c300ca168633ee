"""A folder holds the answers of one checkpoint under one set of options."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from omniocc.errors import UserError
from omniocc.io import atomic_write
from omniocc.predict.output.voxel_files import VOXELS

FACTS = "prediction.json"
"""What made the answers in a folder."""


def claim(output: Path, facts: Mapping[str, Any], force: bool) -> None:
    """Leave in the folder what its answers are made of, so that answers of two models never stand side by side.

    Forced, answers of something else are removed first: a stop halfway leaves none of them.

    Raises:
        UserError: when the folder cannot be written, or holds answers of something else.
    """
    path = output / FACTS
    text = json.dumps(facts, indent=1) + "\n"
    other = path.is_file() and path.read_text() != text
    if other and not force:
        changed = _changed(path.read_text(), facts)
        raise UserError(
            f"{output} holds answers that were made otherwise ({changed}); choose another output=..., or force=true "
            "to predict all moments again"
        )
    try:
        if other:  # before anything says that these answers are the new ones
            for answer in output.rglob(VOXELS):
                answer.unlink()
        atomic_write(path, text)
    except OSError as error:
        reason = (error.__cause__ and str(error.__cause__)) or str(error)
        raise UserError(f"output={output} cannot be written: {reason}; choose another folder: output=...") from error


def _changed(old: str, new: Mapping[str, Any]) -> str:
    try:
        before = json.loads(old)
    except ValueError:
        return f"{FACTS} is damaged"
    return ", ".join(f"{key}: {before.get(key)!r} then" for key in new if before.get(key) != new[key]) or "other facts"


def digest_of(path: Path) -> str:
    """The first 16 hex digits of a file's SHA-256."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            digest.update(block)
    return digest.hexdigest()[:16]


def fingerprint_of_poses(poses: Tensor | None) -> str | None:
    """Of poses to the last bit."""
    return None if poses is None else hashlib.sha256(poses.contiguous().numpy().tobytes()).hexdigest()[:16]
