"""Read checkpoints, and check that their configurations name only classes that may be built."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from omniocc.config import OWN_PACKAGE, PACKAGES_VARIABLE, allowed, check, foreign_packages, target_of
from omniocc.errors import UserError
from omniocc.run.checkpoint_io import read_checkpoint
from omniocc.run.weights import SUFFIX, read_weights

STAGE, CONFIG = "stage", "config"
"""Keys of a checkpoint beside Lightning's own."""
MODEL = "model."
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


def load_checkpoint(path: Path) -> Checkpoint:
    """Return the content of a checkpoint, or of a file of weights.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when it is damaged, not one of this platform, or of an older version.
    """
    content = read_weights(path)[0] if path.suffix == SUFFIX else read_checkpoint(path)
    if STAGE not in content:
        raise UserError(f"{path} names no stage: it is of an older version; train again")
    # resolved, so that `check_parts` sees everything that would be built
    config = DictConfig(content[CONFIG])
    OmegaConf.resolve(config)
    config.pop("packages", None)
    return Checkpoint(path, content[STAGE], config, content["state_dict"], content.get("global_step"))


def check_parts(path: Path, config: DictConfig, parts: Sequence[str], packages: Sequence[str] = ()) -> None:
    """Check root keys (`parts`) of a checkpoint's configuration, with overrides, before anything is built from them.

    Classes of further `packages` may be built; these are never taken from the checkpoint itself.

    Raises:
        UserError: when they name classes of other packages.
        ConfigError: when they do not fit this version.
    """
    trusted = allowed(OWN_PACKAGE, packages)
    chosen = OmegaConf.create({part: config[part] for part in parts})
    if foreign := foreign_packages(OmegaConf.to_container(chosen), trusted):
        names = ",".join(foreign)
        raise UserError(
            f"{path} names classes of {names}, not of this platform; if you trust them, "
            f"allow them by {PACKAGES_VARIABLE}={names} or, for train.py and evaluate.py, packages=[{names}]"
        )
    check(chosen, packages=trusted)


def without_pretrained(model: DictConfig) -> DictConfig:
    """Return the configuration of a model that loads no pretrained weights, since those of a checkpoint replace them.

    A backbone names the arguments that only load weights in `PRETRAINED`; one without it is built as it is.
    """
    changed = model.copy()
    for name in getattr(target_of(model.backbone), "PRETRAINED", ()):
        changed.backbone[name] = None
    return changed
