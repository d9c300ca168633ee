"""Files of weights alone: those that come with the package, by name, and those packed from a checkpoint."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

import omniocc
from omniocc.errors import FAULTS, UserError, first_line, repr_of
from omniocc.io import atomic_write, parse_json

SHIPPED = Path(omniocc.__file__).parent / "weights"
"""Folder of the weights that come with the package; beside each a card (`<name>.md`) says what it is good for."""
SUFFIX = ".safetensors"
FORMAT = "omniocc-weights-1"
HEADER: dict[str, type] = {"stage": str, "config": dict, "facts": dict, "sha256": str}
"""Keys of the text in a header, and their types."""
LAST, BEST = "last.ckpt", "best.ckpt"
"""Checkpoints of a run, in its folder."""


def shipped() -> list[str]:
    """Return the names of the weights that come with the package."""
    return sorted(path.stem for path in SHIPPED.glob(f"*{SUFFIX}"))


def find_checkpoint(given: str | Path) -> Path:
    """Return a checkpoint's file: a path, that in a run's folder (its best one, else its last), or shipped weights.

    `given` is their name then. What does not exist is returned as it is.
    """
    path = Path(given)
    named = SHIPPED / f"{given}{SUFFIX}"
    if not path.exists() and path.name == str(given) and named.is_file():
        return named
    return next((path / name for name in (BEST, LAST) if (path / name).is_file()), path)


def digest_of(weights: Mapping[str, Tensor]) -> str:
    """Return a hash of the names, types, shapes and values of weights."""
    digest = hashlib.sha256()
    for name, value in sorted(weights.items()):
        digest.update(f"{name} {value.dtype} {tuple(value.shape)}\n".encode())
        digest.update(value.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def pack_weights(
    path: Path,
    stage: str,
    config: Mapping[str, Any],
    weights: Mapping[str, Tensor],
    facts: Mapping[str, Any],
    half: bool = False,
) -> None:
    """Write weights, the configuration that builds their model, and facts about their training to one file.

    With `half` floating values are kept in 16 bits where they fit, below 65,520; reading them gives 32 again.

    Raises:
        DataError: when the disk refuses.
    """
    kept = {name: _kept(value, half) for name, value in weights.items()}
    about = {"stage": stage, "config": config, "facts": facts, "sha256": digest_of(kept)}
    atomic_write(path, save(kept, {FORMAT: json.dumps(about, sort_keys=True)}))


def read_weights(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the content of a file of weights, as that of a checkpoint, and the facts about its training.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when it is damaged, or not a file of this platform.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file of weights")
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    except (SafetensorError, OSError, *FAULTS) as error:
        raise UserError(f"{path} is damaged or not a file of weights: {error}") from error
    if FORMAT not in metadata:
        raise UserError(f"{path} is not a file of weights of this platform: it has no '{FORMAT}' in its header")
    about = _about(path, metadata[FORMAT])
    if digest_of(weights) != about["sha256"]:
        raise UserError(f"{path} is damaged: its weights do not have the hash that it states; install or copy it again")
    full = {name: value.float() if value.dtype == torch.float16 else value for name, value in weights.items()}
    return {"stage": about["stage"], "config": about["config"], "state_dict": full}, about["facts"]


def _about(path: Path, text: str) -> dict[str, Any]:
    """Return what the header of a file of weights tells; raise UserError when it is damaged."""
    try:
        about = parse_json(text)
        if not isinstance(about, dict):
            raise ValueError(f"it is {repr_of(about)}, no mapping")
        for key, kind in HEADER.items():
            if not isinstance(value := about.get(key), kind):
                raise ValueError(f"its {key} is {repr_of(value)}, no {'text' if kind is str else 'mapping'}")
    except FAULTS as error:
        raise UserError(f"{path} is damaged: its header cannot be read ({first_line(error)})") from error
    return about


def _kept(value: Tensor, half: bool) -> Tensor:
    value = value.detach().cpu().contiguous()
    if not half or not value.is_floating_point():
        return value
    halved = value.half()
    return halved if halved.isfinite().all() else value
