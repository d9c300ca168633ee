"""Read and check checkpoints: one from a stranger may name classes that `conf` offers, and no others."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn

from omniocc.config import (
    OWN_PACKAGE,
    PACKAGES_VARIABLE,
    ConfigError,
    allowed,
    check,
    plain,
)
from omniocc.errors import UserError, shortened
from omniocc.parallel import usable_cores
from omniocc.runs.checkpoint_io import read_checkpoint
from omniocc.runs.renamed import renamed
from omniocc.runs.script import read_overrides
from omniocc.runs.slots import foreign_packages
from omniocc.runs.trust import fault_of, not_offered
from omniocc.runs.weights import SUFFIX, find_checkpoint, read_weights

STAGE, CONFIG = "stage", "config"
"""Keys of a checkpoint that this platform adds to those of Lightning."""
STAGES = ("depth", "sketch", "occupancy")
FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
"""Floating-point types that weights may have; torch does not compute in those of 8 bits or fewer."""
Network = TypeVar("Network", bound=nn.Module)
MODEL = "model."
"""Prefix of the names of the model's weights in a task."""
WORKER_KEYS = ("data.num_workers", "data.source.workers")
"""Keys of numbers of processes, which were chosen for the machine of the training: `load_checkpoint` limits them."""
PREFIXES = {
    "depth": {"occupancy": "sketch.depth.", "sketch": "depth.", "depth": ""},
    "sketch": {"occupancy": "sketch.", "sketch": ""},
}
"""By part and stage: the prefix of the names of the part's weights in the model of that stage."""


class Checkpoint(NamedTuple):
    """Content of a checkpoint.

    Attributes:
        path: the file.
        stage: `depth`, `sketch` or `occupancy`.
        config: configuration of the run that wrote it, without interpolations.
        weights: of the whole task, by their names in the task.
        step: number of optimiser steps done so far; None for a file of weights alone.
    """

    path: Path
    stage: str
    config: DictConfig
    weights: dict[str, Tensor]
    step: int | None

    @property
    def model_weights(self) -> dict[str, Tensor]:
        """Return the weights of the task's model, by their names in the model."""
        return _below(self.weights, MODEL)


def part_weights(trained: Checkpoint, part: str) -> dict[str, Tensor]:
    """Return the weights of a part in a checkpoint, by their names in the part.

    Args:
        trained: the checkpoint.
        part: `depth`, or `sketch`, which includes its depth.

    Raises:
        UserError: when the checkpoint does not hold the part.
    """
    prefix = PREFIXES[part].get(trained.stage)
    weights = {} if prefix is None else _below(trained.model_weights, prefix)
    if not weights:
        raise UserError(
            f"{trained.path} holds no {part} network; the stage's own checkpoints are runs/stages/{part}-*/last.ckpt"
        )
    return weights


def _below(weights: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the weights whose names begin with a prefix, by their names without it."""
    return {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}


def load_checkpoint(given: str | Path) -> Checkpoint:
    """Return the content of a checkpoint, or of a file of weights; `find_checkpoint` says what may be given.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when the file is damaged, of another program or of an older version, or its configuration is refused.
    """
    path = find_checkpoint(given)
    content = read_weights(path)[0] if path.suffix == SUFFIX else read_checkpoint(path)
    if STAGE not in content:
        raise UserError(f"{path} names no stage: it is of an older version; train again")
    stage, config, weights = content[STAGE], content[CONFIG], content["state_dict"]
    if stage not in STAGES:
        raise UserError(f"{path} names a stage that does not exist; there are {', '.join(STAGES)}")
    if not isinstance(weights, dict) or not all(_is_weight(*item) for item in weights.items()):
        raise UserError(f"{path} is damaged: its weights are no tensors of real numbers by name")
    step = content.get("global_step")
    if not isinstance(step, int | None):
        raise UserError(f"{path} is damaged: its number of steps is no whole number")
    if (fault := fault_of(config)) is not None:
        raise UserError(f"{path} cannot be trusted: {fault}")
    # a file does not choose the packages whose classes are built from it; see `check_parts`
    tree = OmegaConf.create({key: value for key, value in renamed(config).items() if key != "packages"})
    for key in WORKER_KEYS:
        if isinstance(count := OmegaConf.select(tree, key, throw_on_missing=False), int):
            OmegaConf.update(tree, key, min(count, usable_cores()))
    return Checkpoint(path, stage, tree, weights, step)


def _is_weight(name: object, value: object) -> bool:
    """Return whether an entry is a name and a tensor that a network can have: dense, on the CPU, of real numbers."""
    if not isinstance(name, str) or not isinstance(value, Tensor):
        return False
    whole = not (value.is_floating_point() or value.is_complex() or value.is_quantized)
    usable = value.layout == torch.strided and value.device.type == "cpu" and (whole or value.dtype in FLOATS)
    # a tensor larger than its storage repeats numbers (stride 0): a small file could claim any size
    return usable and value.nbytes <= value.untyped_storage().nbytes()


def load_weights(
    network: Network, weights: Mapping[str, Tensor], path: Path, question: str = "was it written by another version?"
) -> Network:
    """Load weights into a network, and return the network.

    Args:
        network: is changed.
        weights: by their names in the network.
        path: file of the weights, which errors name.
        question: possible cause, which ends the message about weights that do not fit.

    Raises:
        UserError: when the weights do not fit or are not finite.
    """
    try:
        network.load_state_dict(weights)
    except RuntimeError as error:
        first = str(error).splitlines()[1:2] or [str(error)]  # torch names the network, then one fault a line
        raise UserError(f"{path}: its weights do not fit: {shortened(first[0].strip(), 300)}; {question}") from error
    if not all(bool(value.isfinite().all()) for value in weights.values()):
        raise UserError(f"{path} holds weights that are not finite (NaN): its training failed, use another checkpoint")
    return network


def check_parts(path: Path, config: DictConfig, parts: Sequence[str], packages: Sequence[str] = ()) -> None:
    """Check parts of a checkpoint's configuration, before anything is built from them.

    Each class must be one that `conf` offers for its place (`omniocc.runs.trust`), or be in one of
    `packages` or of the packages that `OMNIOCC_PACKAGES` names.

    Args:
        path: of the checkpoint, which errors name.
        config: of the checkpoint, with overrides.
        parts: root keys to check.
        packages: further packages whose classes may be built, chosen by the user and never by the checkpoint.

    Raises:
        UserError: when a part names a class of another package, or one that is not offered for its place.
        ConfigError: when a part does not fit this version.
    """
    nodes = {part: config.get(part) for part in parts}
    if wrong := [part for part, node in nodes.items() if not isinstance(node, DictConfig) or "_target_" not in node]:
        raise UserError(f"{path} is damaged or of another version: its configuration has no {wrong[0]} to build")
    trusted = allowed(OWN_PACKAGE, packages)
    chosen = OmegaConf.create(nodes)
    tree = plain(chosen)
    if foreign := foreign_packages(tree, trusted):
        names = ",".join(foreign)
        # the standard library holds nobody's model, so the message does not suggest to allow it
        if any(name in sys.stdlib_module_names for name in foreign):
            raise UserError(f"{path} cannot be trusted: it names classes of {names}")
        raise UserError(
            f"{path} names classes of {names}, not of this platform; if you trust them, "
            f"allow them by {PACKAGES_VARIABLE}={names} or, for train.py and evaluate.py, packages=[{names}]"
        )
    if refused := next(not_offered(tree, trusted), None):
        raise UserError(f"{path} cannot be trusted: {refused}")
    try:
        check(chosen, packages=trusted)
    except ConfigError as error:
        if "evidence_in_volume" in chosen.get("model", ()):  # key of older versions; now the slot `hints`
            raise UserError(f"{path} is of an older version: its model has no hints; train again") from error
        raise ConfigError(error.problems, path) from error


def apply_overrides(config: DictConfig, overrides: Sequence[str]) -> DictConfig:
    """Return a checkpoint's configuration with overrides (`key=value`) applied and interpolations resolved.

    Raises:
        UserError: naming an override that cannot be read.
    """
    merged = config.copy()
    for key, value in read_overrides(overrides).items():
        OmegaConf.update(merged, key, value, merge=True, force_add=True)
    return OmegaConf.create(OmegaConf.to_container(merged, resolve=True))  # type: ignore[return-value]
