"""The stages of a configuration, and hashes of everything that decides their results."""

from collections.abc import Mapping
from typing import Any, NamedTuple, cast

from omegaconf import DictConfig

from omniocc.config import own_code, plain, target_of
from omniocc.errors import UserError
from omniocc.model.protocols import LearnedSketch
from omniocc.run.folder import OF_MACHINES, short_hash, with_digest
from omniocc.run.slots import sketch_learns

STAGES = ("depth", "sketch", "occupancy")
VERSIONS = {"depth": 4, "sketch": 1, "candidates": 1}
"""Versions in the hashes: increase one when the same configuration gives other results."""

OVERRULED = ("max_steps", "max_epochs", "check_val_every_n_epoch", "val_check_interval", "strategy", *OF_MACHINES)
"""Trainer options that a stage sets itself, or that do not change its results."""


def wanted_stages(cfg: DictConfig) -> tuple[str, ...]:
    """Return the stages up to the configured one (`stage=...`), in order.

    Raises:
        UserError: for an unknown stage, or one that the model does not have.
    """
    stage = cfg.stage or "occupancy"
    if stage not in STAGES:
        raise UserError(f"stage={stage}: choose one of {', '.join(STAGES)}; leave it out to run all missing ones")
    present = STAGES if sketch_learns(cfg) else STAGES[-1:]
    if stage not in present:
        raise UserError(f"stage={stage}: this model/sketch has no such stage; choose model/sketch=omni or mono")
    return present[: present.index(stage) + 1]


class Keys(NamedTuple):
    """Hashes of everything that decides the results of a stage."""

    depth: str
    sketch: str
    candidates: str


def stage_keys(cfg: DictConfig, data_fingerprint: str) -> Keys:
    """Return the hashes for a configuration with a learned sketch."""
    config = plain(cfg)
    trainer = _without(config["trainer"], OVERRULED)
    together = config["data"].get("frames_together", 1)  # decides the order of the samples
    trainer |= {} if together == 1 else {"frames_together": together}
    stages = {stage: with_digest(f"stages.{stage}.weights", recipe) for stage, recipe in config["stages"].items()}
    sketch = config["model"]["sketch"]
    selection = cast(type[LearnedSketch], target_of(sketch)).SELECTION
    appearance = [config["appearance"]] if config.get("appearance") else []
    depth_key = short_hash(
        [
            *(VERSIONS["depth"], config["depth"], stages["depth"], trainer, data_fingerprint, *appearance),
            *own_code([config["depth"], stages["depth"], *appearance]),
        ]
    )
    network = _without(sketch, selection)
    labels = config["data"]["unknown"]
    code = own_code([network, stages["sketch"]])
    sketch_key = short_hash([VERSIONS["sketch"], depth_key, network, stages["sketch"], trainer, labels, *code])
    arguments = {name: sketch[name] for name in selection}
    return Keys(depth_key, sketch_key, short_hash([VERSIONS["candidates"], sketch_key, arguments]))


def _without(arguments: Mapping[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    return {key: value for key, value in arguments.items() if key not in names}
