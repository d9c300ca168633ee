"""Rebuild a trained task from its checkpoint file alone."""

from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf

from omniocc.config import build, check, plain
from omniocc.data import OccupancyData, SourceSpec
from omniocc.errors import UserError
from omniocc.run.checkpoint_io import read_checkpoint
from omniocc.task.occupancy import Occupancy

PARTS = ("model", "loss", "optimizer", "augment")
"""What a task is built of."""

TRUSTED = ("omniocc",)
"""A stranger's checkpoint may only name classes of ours: reading it runs no code of its own."""


def load_config(path: Path) -> tuple[DictConfig, dict[str, torch.Tensor]]:
    """Configuration and weights of a checkpoint.

    Raises:
        FileNotFoundError: when it is not there.
        UserError: when it is damaged or not one of ours.
    """
    content = read_checkpoint(path)
    return DictConfig(content["config"]), content["state_dict"]


def model_weights(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Those of the task's model, named as in the model."""
    prefix = "model."
    return {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}


def build_task(cfg: DictConfig, spec: SourceSpec) -> Occupancy:
    """Return the task that a configuration describes for data with this spec, with fresh weights."""
    model, loss, optimizer, augment = (build(cfg[part]) for part in PARTS)
    return Occupancy(model, loss, optimizer, augment, cfg.ema_decay, spec, plain(cfg))


def load_task(path: Path, overrides: list[str]) -> tuple[Occupancy, OccupancyData]:
    """Return the trained task of a checkpoint and the data of its configuration with `key=value` overrides.

    Raises:
        ConfigError: when an override does not fit.
        FileNotFoundError, UserError: see `load_config`.
    """
    cfg, weights = load_config(path)
    cfg = OmegaConf.merge(cfg, OmegaConf.from_dotlist(overrides))
    assert isinstance(cfg, DictConfig)
    absent = [key for key in (*PARTS, "data", "ema_decay") if key not in cfg]
    if absent:
        raise UserError(f"{path} is of another version or stage: its configuration has no {', '.join(absent)}")
    for part in (*PARTS, "data"):
        check(OmegaConf.create({part: cfg[part]}), packages=TRUSTED)
    data: OccupancyData = build(cfg.data)
    data.check_classes()
    task = build_task(cfg, data.source.spec)
    task.load_state_dict(weights, strict=True)
    return task, data
