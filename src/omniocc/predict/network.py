"""Load a depth option or a whole occupancy model from its checkpoint; apply a depth option to any rig."""

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float32
from omegaconf import DictConfig
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.errors import UserError
from omniocc.model import OccupancyModel
from omniocc.model.depth import DepthMap
from omniocc.run.checkpoint import (
    check_parts,
    load_checkpoint,
    load_weights,
    part_weights,
    with_overrides,
    without_pretrained,
)
from omniocc.run.trust import building


def load_depth(path: Path, overrides: Sequence[str] = ()) -> tuple[nn.Module, DictConfig]:
    """Return the trained depth option of a checkpoint and the configuration of its training.

    Args:
        path: `runs/stages/depth-<hash>/last.ckpt`, or a checkpoint of a later stage, which holds the same weights.
        overrides: `depth.<argument>=<value>`, arguments that differ from those of the training.

    Raises:
        FileNotFoundError: when the file does not exist.
        UserError: when it is damaged, holds no depth network, or an override does not fit its weights.
        ConfigError: when an override names an unknown argument.
    """
    trained = load_checkpoint(path)
    own = part_weights(trained, "depth")
    merged = with_overrides(trained.config, overrides)
    check_parts(path, merged, ["depth"])
    question = "is it a checkpoint of the depth stage, are overrides needed?"
    with building(path, own):
        depth = build(merged.depth)
    return load_weights(depth, own, path, question).eval(), merged


def load_occupancy(path: Path) -> tuple[OccupancyModel, DictConfig]:
    """Return the model of an occupancy checkpoint, sketch and depth included, and the configuration of its training.

    `path` is `runs/<name>-<hash>/best.ckpt` or `last.ckpt`.

    Raises:
        FileNotFoundError: when the file does not exist.
        UserError: when it is damaged, of another stage, or its weights do not fit or are not finite.
        ConfigError: when its configuration names classes or arguments that this version does not have.
    """
    trained = load_checkpoint(path)
    cfg, own = trained.config, trained.model_weights
    if trained.stage != "occupancy":
        raise UserError(
            f"{path} is a checkpoint of the {trained.stage} stage; predict occupancy needs one of the occupancy stage, "
            "such as runs/<name>-<hash>/best.ckpt"
        )
    check_parts(path, cfg, ["model"])
    with building(path, own):
        model = build(without_pretrained(cfg.model))
    return load_weights(model, own, path).eval(), cfg


def predict_depth(model: nn.Module, images: Float32[Tensor, "1 N 3 H W"], rig: Rig, device: torch.device) -> DepthMap:
    """Return the range panorama that a depth option computes on `device` from the images of one frame, on the CPU.

    The images are in [0, 1], and the rig is the one at their size.

    Raises:
        UserError: when the option needs more than images, or returns NaN.
    """
    with torch.inference_mode():
        try:
            depth = model.to(device)(images.to(device), (rig,))
        except ValueError as error:
            raise UserError(str(error)) from error
        depth = DepthMap(*(part.cpu() for part in depth))
    if not bool(depth.range_m.isfinite().all()):
        raise UserError("the network returns NaN: its weights are damaged, use another checkpoint")
    return depth
