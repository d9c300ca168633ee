"""The file that tells what the predictions of a folder were made from: one checkpoint and one set of options."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from omniocc.errors import UserError
from omniocc.io import atomic_write, parse_json, read_short_text
from omniocc.predict.output.voxel_files import VOXELS

MANIFEST = "prediction.json"
OWN_RIG = "prediction.rig.yaml"
"""The cameras of a user's own images, beside their predictions."""
DIGESTS = {
    "checkpoint": "another checkpoint",
    "rig": f"another rig or road_z_m (theirs: {OWN_RIG})",
    "poses": "other poses",
    "sha256": "other weights in the checkpoint",
    "data": "other data",
}
"""What is said of facts that are kept as digests, of which a reader can make nothing."""


def write_manifest(output: Path, facts: Mapping[str, Any], force: bool, files: str = VOXELS) -> None:
    """Write what the predictions of a folder are made from, so that it never mixes those of two models.

    The facts are checkpoint, input and options. `force` replaces a manifest with other facts, after removing its
    predictions, which are called `files`.

    Raises:
        UserError: when the folder cannot be written, or its predictions were made from other facts.
    """
    path = output / MANIFEST
    text = json.dumps(facts, indent=1) + "\n"
    differs = path.is_file() and path.read_text("utf-8") != text
    if differs and not force:
        changed = _changed(path.read_text("utf-8"), facts)
        raise UserError(
            f"{output} holds predictions made with {changed}; choose another output=..., or force=true to predict all "
            "frames again"
        )
    try:
        if differs:  # before the new manifest, so that a stop between the two leaves no old prediction under it
            for prediction in output.rglob(files):
                prediction.unlink()
        atomic_write(path, text)
    except OSError as error:
        reason = (error.__cause__ and str(error.__cause__)) or str(error)
        raise UserError(f"output={output} cannot be written: {reason}; choose another folder: output=...") from error


def read_manifest(output: Path) -> dict[str, Any]:
    """Return what the predictions of a folder were made from.

    Raises:
        UserError: when the folder has no manifest, or a damaged one.
    """
    try:
        facts = parse_json(read_short_text(output / MANIFEST))
    except FileNotFoundError as error:
        raise UserError(f"{output} holds no predictions of predict.py occupancy (no {MANIFEST})") from error
    except ValueError as error:
        raise UserError(f"{output / MANIFEST} is damaged: {error}") from error
    if not isinstance(facts, dict):
        raise UserError(f"{output / MANIFEST} is damaged: it holds no facts")
    return facts


def _changed(old: str, new: Mapping[str, Any]) -> str:
    try:
        before = parse_json(old)
    except ValueError:
        return f"facts that cannot be read any more ({MANIFEST} is damaged)"
    changed = [key for key in {**before, **new} if before.get(key) != new.get(key)]
    words = [DIGESTS.get(key) or f"{key}={_word(before.get(key))} (now {_word(new.get(key))})" for key in changed]
    return ", ".join(words) or "the same options in another order"


def _word(value: Any) -> str:
    return "null" if value is None else str(value)


def pose_digest(poses: Tensor | None) -> str | None:
    """Return the first 16 hex digits of the poses' SHA-256, None without poses."""
    return None if poses is None else hashlib.sha256(poses.contiguous().numpy().tobytes()).hexdigest()[:16]
