"""A depth option from a checkpoint or from a configuration, and its answer for pictures of any rig."""

from collections.abc import Sequence
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn

from omniocc.camera import Rig
from omniocc.config import build, check
from omniocc.errors import UserError
from omniocc.model.depth import DepthMap
from omniocc.task.checkpoint import TRUSTED, load_config, model_weights


def load_depth(path: Path, overrides: Sequence[str] = ()) -> tuple[nn.Module, DictConfig]:
    """The trained depth option of a stage's checkpoint, and the configuration it was trained with.

    Args:
        path: `runs/stages/depth-<hash>/last.ckpt`.
        overrides: `depth.<argument>=<value>`, in which it is to differ from the trained one.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when it is damaged, not of the depth stage, or an override does not fit its weights.
        ConfigError: when an override names no argument.
    """
    cfg, weights = load_config(path)
    own = model_weights(weights)
    if "depth" not in cfg or not own:
        raise UserError(f"{path} is no checkpoint of the depth stage; those are runs/stages/depth-*/last.ckpt")
    merged = OmegaConf.merge(cfg, OmegaConf.from_dotlist(list(overrides)))
    assert isinstance(merged, DictConfig)
    check(OmegaConf.create({"depth": merged.depth}), packages=TRUSTED)
    model = build(merged.depth)
    try:
        model.load_state_dict(own)
    except RuntimeError as error:
        first = str(error).splitlines()[1:2] or [str(error)]
        raise UserError(
            f"{path}: its weights do not fit: {first[0].strip()}; is it of the depth stage, are overrides needed?"
        ) from error
    if not all(bool(value.isfinite().all()) for value in own.values()):
        raise UserError(f"{path} holds weights that are no numbers (NaN): its training failed, take another checkpoint")
    return model.eval(), merged


def predict_depth(model: nn.Module, images: Tensor, rig: Rig, device: torch.device) -> DepthMap:
    """The panorama of one frame, on the CPU.

    Args:
        model: a depth option.
        images: (1, N, 3, H, W), in [0, 1].
        rig: at the images' size.
        device: where to compute.

    Raises:
        UserError: when the option needs what pictures do not tell, or answers with NaN.
    """
    with torch.inference_mode():
        try:
            depth = model.to(device)(images.to(device), (rig,))
        except ValueError as error:
            raise UserError(str(error)) from error
        depth = DepthMap(*(part.cpu() for part in depth))
    if not bool(depth.range_m.isfinite().all()):
        raise UserError("the network answers with NaN: its weights are damaged, take another checkpoint")
    return depth
