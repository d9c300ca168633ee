"""Load a depth option or a whole occupancy model from its checkpoint; apply a depth option to any rig."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.config import build, check
from omniocc.errors import UserError
from omniocc.model import OccupancyModel
from omniocc.model.depth import DepthMap
from omniocc.task.checkpoint import TRUSTED, load_config, model_weights

Network = TypeVar("Network", bound=nn.Module)


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
    cfg, weights = load_config(path)
    own = depth_weights(model_weights(weights))
    if "depth" not in cfg or not own:
        raise UserError(f"{path} holds no depth network; the stage's own checkpoints are runs/stages/depth-*/last.ckpt")
    merged = OmegaConf.merge(cfg, OmegaConf.from_dotlist(list(overrides)))
    assert isinstance(merged, DictConfig)
    check(OmegaConf.create({"depth": merged.depth}), packages=TRUSTED)
    return _with_weights(
        build(merged.depth), own, path, "is it a checkpoint of the depth stage, are overrides needed?"
    ), merged


def load_occupancy(path: Path) -> tuple[OccupancyModel, DictConfig]:
    """Return the model of an occupancy checkpoint, sketch and depth included, and the configuration of its training.

    Args:
        path: `runs/<name>-<hash>/best.ckpt` or `last.ckpt`.

    Raises:
        FileNotFoundError: when the file does not exist.
        UserError: when it is damaged, of another stage, or its weights do not fit or are not finite.
        ConfigError: when its configuration names classes or arguments that this version does not have.
    """
    cfg, weights = load_config(path)
    own = model_weights(weights)
    stage = stage_of(own)
    if "model" not in cfg or stage != "occupancy":
        raise UserError(
            f"{path} is a checkpoint of the {stage} stage; predict occupancy needs one of the occupancy stage, "
            "such as runs/<name>-<hash>/best.ckpt"
        )
    check(OmegaConf.create({"model": cfg.model}), packages=TRUSTED)
    return _with_weights(build(without_download(cfg.model)), own, path, "was it written by another version?"), cfg


def depth_weights(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the weights of the depth network out of those of any stage's model, named as in the network."""
    prefix = {"occupancy": "sketch.depth.", "sketch": "depth.", "depth": ""}[stage_of(weights)]
    return {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}


def stage_of(weights: Mapping[str, Tensor]) -> str:
    """Return the stage that trained the model with these weights."""
    parts = {name.split(".")[0] for name in weights}
    return "occupancy" if "classifier" in parts else "sketch" if "depth" in parts else "depth"


def without_download(model: DictConfig) -> DictConfig:
    """Return the configuration with `weights=None` for a ResNet, since a checkpoint holds the trained weights.

    Other backbones also take their architecture from the hub.
    """
    if not str(model.backbone["_target_"]).endswith(".ResNet"):
        return model
    merged = OmegaConf.merge(model, {"backbone": {"weights": None}})
    assert isinstance(merged, DictConfig)
    return merged


def _with_weights(model: Network, weights: Mapping[str, Tensor], path: Path, question: str) -> Network:
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        first = str(error).splitlines()[1:2] or [str(error)]
        raise UserError(f"{path}: its weights do not fit: {first[0].strip()}; {question}") from error
    if not all(bool(value.isfinite().all()) for value in weights.values()):
        raise UserError(f"{path} holds weights that are not finite (NaN): its training failed, use another checkpoint")
    return model.eval()


def predict_depth(model: nn.Module, images: Tensor, rig: Rig, device: torch.device) -> DepthMap:
    """Return the range panorama of one frame, on the CPU.

    Args:
        model: a depth option.
        images: (1, N, 3, H, W), in [0, 1].
        rig: at the images' size.
        device: to compute on.

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
