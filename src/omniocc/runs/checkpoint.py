"""Read checkpoints, which may come from anybody: they may name options of the slots and nothing else."""

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
from omniocc.runs.slots import foreign_packages
from omniocc.runs.trust import fault_of, not_offered
from omniocc.runs.weights import SUFFIX, find_checkpoint, read_weights

STAGE, CONFIG = "stage", "config"
"""Keys of a checkpoint beside Lightning's own."""
STAGES = ("depth", "sketch", "occupancy")
FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
"""Types of weights with fractions; torch does not compute in the others, of 8 bits or fewer."""
Network = TypeVar("Network", bound=nn.Module)
MODEL = "model."
WORKERS = ("data.num_workers", "data.source.workers")
"""Numbers of processes, which are those of another machine."""
PREFIXES = {
    "depth": {"occupancy": "sketch.depth.", "sketch": "depth.", "depth": ""},
    "sketch": {"occupancy": "sketch.", "sketch": ""},
}
"""Prefix of the names of a part's weights, in the model of every stage that holds the part."""


class Checkpoint(NamedTuple):
    """Content of a checkpoint.

    Attributes:
        path: the file.
        stage: `depth`, `sketch` or `occupancy`.
        config: of the run that wrote it, without interpolations.
        weights: of the whole task, named as in the task.
        step: optimiser steps that were done; None for a file of weights alone.
    """

    path: Path
    stage: str
    config: DictConfig
    weights: dict[str, Tensor]
    step: int | None

    @property
    def model_weights(self) -> dict[str, Tensor]:
        """Return the weights of the task's model, named as in the model."""
        return {name.removeprefix(MODEL): value for name, value in self.weights.items() if name.startswith(MODEL)}


def part_weights(trained: Checkpoint, part: str) -> dict[str, Tensor]:
    """Return the weights of a part (depth, or sketch with its depth) that a checkpoint holds, named as in the part.

    Raises:
        UserError: when it holds none.
    """
    prefix, named = PREFIXES[part].get(trained.stage, "nothing."), trained.model_weights
    own = {name.removeprefix(prefix): value for name, value in named.items() if name.startswith(prefix)}
    if not own:
        raise UserError(
            f"{trained.path} holds no {part} network; the stage's own checkpoints are runs/stages/{part}-*/last.ckpt"
        )
    return own


def load_checkpoint(given: str | Path) -> Checkpoint:
    """Return the content of a checkpoint, or of a file of weights; see `find_checkpoint`.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when it is damaged, not one of this platform, or of an older version.
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
    tree = OmegaConf.create({key: value for key, value in renamed(config).items() if key != "packages"})
    for key in WORKERS:
        if isinstance(count := OmegaConf.select(tree, key, throw_on_missing=False), int):
            OmegaConf.update(tree, key, min(count, usable_cores()))
    return Checkpoint(path, stage, tree, weights, step)


def _is_weight(name: object, value: object) -> bool:
    """Return whether an entry of a file is a name and a tensor of numbers in memory that a network can have."""
    if not isinstance(name, str) or not isinstance(value, Tensor):
        return False
    whole = not (value.is_floating_point() or value.is_complex() or value.is_quantized)
    real = value.layout == torch.strided and value.device.type == "cpu" and (whole or value.dtype in FLOATS)
    return real and value.nbytes <= value.untyped_storage().nbytes()  # else it repeats few numbers, in any size


def load_weights(
    network: Network, weights: Mapping[str, Tensor], path: Path, question: str = "was it written by another version?"
) -> Network:
    """Load the weights of the checkpoint at `path` into a network, and return it.

    Raises:
        UserError: when they do not fit (the line ends with the question) or are not finite.
    """
    try:
        network.load_state_dict(weights)
    except RuntimeError as error:
        first = str(error).splitlines()[1:2] or [str(error)]
        raise UserError(f"{path}: its weights do not fit: {shortened(first[0].strip(), 300)}; {question}") from error
    if not all(bool(value.isfinite().all()) for value in weights.values()):
        raise UserError(f"{path} holds weights that are not finite (NaN): its training failed, use another checkpoint")
    return network


def check_parts(path: Path, config: DictConfig, parts: Sequence[str], packages: Sequence[str] = ()) -> None:
    """Check root keys (`parts`) of a checkpoint's configuration, with overrides, before anything is built from them.

    Each class has to be one that `conf` offers for its place (`omniocc.runs.trust`). Classes of further `packages`
    may be built; these are never taken from the checkpoint itself.

    Raises:
        UserError: when they name classes of other packages, or classes that are not offered at their place.
        ConfigError: when they do not fit this version.
    """
    nodes = {part: config.get(part) for part in parts}
    if wrong := [part for part, node in nodes.items() if not isinstance(node, DictConfig) or "_target_" not in node]:
        raise UserError(f"{path} is damaged or of another version: its configuration has no {wrong[0]} to build")
    trusted = allowed(OWN_PACKAGE, packages)
    chosen = OmegaConf.create(nodes)
    tree = plain(chosen)
    if foreign := foreign_packages(tree, trusted):
        names = ",".join(foreign)
        if any(name in sys.stdlib_module_names for name in foreign):  # which nobody allows for a model of theirs
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
        if "evidence_in_volume" in chosen.get("model", ()):  # a key that the slot `hints` replaced
            raise UserError(f"{path} is of an older version: its model has no hints; train again") from error
        raise ConfigError(error.problems, path) from error


def with_overrides(config: DictConfig, overrides: Sequence[str]) -> DictConfig:
    """Return the configuration of a checkpoint with changes (`key=value`) from the command line, resolved."""
    merged = OmegaConf.merge(config, OmegaConf.from_dotlist(list(overrides)))
    return OmegaConf.create(OmegaConf.to_container(merged, resolve=True))  # type: ignore[return-value]
