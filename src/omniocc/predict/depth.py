"""The command `predict.py depth`: from a calibrated rig's images to range panoramas in files."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import torch
from jaxtyping import Float32
from omegaconf import DictConfig, ListConfig, OmegaConf
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.config import check
from omniocc.draw import predicted_sheet
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.predict.input.images import FrameFiles, find_frames, read_frame, remarks, resized_to_width
from omniocc.predict.options import choose_device, load_rig, require
from omniocc.predict.output.range_files import point_cloud, write_depth
from omniocc.predict.predictor import predict_depth
from omniocc.predict.road import NO_ROAD, check_within, on_road, road_line
from omniocc.predict.stopwatch import Stopwatch
from omniocc.predict.trained import load

SWEEP = "sweep"
"""Value of `checkpoint` that chooses the option of `model/depth`, without weights, as null does."""

ShowRanges = Callable[[FrameFiles, Sequence[np.ndarray], Rig, Float32[Tensor, "h w"], Equirectangular], None]
"""Shows the panorama of one frame: given the frame, its images, their rig, the ranges and their directions."""


def predict_panoramas(cfg: DictConfig, overrides: Sequence[str], show: ShowRanges | None = None) -> None:
    """Predict every frame, write its folder of files and show it; `cfg` is composed from `conf/predict_depth.yaml`.

    Raises:
        UserError, FileNotFoundError: naming the option, file or checkpoint that cannot be used.
    """
    require(cfg, ("rig", "images"), "predict.py depth")
    rig = load_rig(cfg.rig)
    images = [str(path) for path in cfg.images] if isinstance(cfg.images, ListConfig) else str(cfg.images)
    frames = find_frames(images, rig, [str(name) for name in cfg.exclude_cameras], cfg.image_bits)
    for line in remarks(frames, rig):
        print(line, flush=True)
    check_within(cfg.road_within)
    model, image_width = choose_model(cfg, overrides, rig)
    if rig.road_z_m is None and getattr(model, "hints", False):
        print(f"road      {NO_ROAD}", flush=True)
    device = choose_device(cfg.device)
    for frame in frames:
        print(predict_frame(cfg, frame, rig, model, image_width, device=device, show=show), flush=True)


def choose_model(cfg: DictConfig, overrides: Sequence[str], rig: Rig) -> tuple[nn.Module, int | None]:
    """Return the depth option, and the width of the images that it is applied to (None: the rig's).

    Raises:
        UserError: naming the override that the weights set, or what does not fit.
    """
    if cfg.checkpoint in (None, SWEEP):
        check(OmegaConf.create({"depth": OmegaConf.to_container(cfg.depth, resolve=True)}))
        return Parts(cfg).depth().eval(), cfg.image_width
    overrides = [text.lstrip("+") for text in overrides]
    conflicting = [text for text in overrides if text.startswith(("model/", "preset", "depth="))]
    if conflicting:
        raise UserError(
            f"{conflicting[0]}: checkpoint={cfg.checkpoint} sets this; leave it out, or choose checkpoint={SWEEP}, "
            "the option of model/depth without weights"
        )
    trained = load(cfg.checkpoint, [text for text in overrides if text.startswith("depth.")])
    chosen = any(text.startswith("image_width=") for text in overrides)
    return trained.depth, cfg.image_width if chosen else trained.facts.width_for(rig)


def predict_frame(
    cfg: DictConfig,
    frame: FrameFiles,
    rig: Rig,
    model: nn.Module,
    image_width: int | None,
    device: torch.device,
    show: ShowRanges | None,
) -> str:
    """Predict one frame, write its files, show it, and return a line about it."""
    folder = Path(cfg.output) / frame.name
    watch = Stopwatch(device, ("read", "depth", "write"))
    with watch("read"):
        images = read_frame(frame, rig)
        batch, scaled = resized_to_width(images, rig, image_width)
    with watch("depth"):
        depth = on_road(predict_depth(model, batch, scaled, device), model, scaled, cfg.road_within)
    with watch("write"):
        range_m, panorama = depth.known_range_m()[0], cast(Equirectangular, model.panorama)
        cloud = point_cloud(range_m, panorama, images, rig)
        missing = [name for name, file in zip(rig.names, frame.files, strict=True) if file is None]
        caption = " ".join([frame.name, f"without {', '.join(missing)}" if missing else ""]).strip()
        overview = predicted_sheet(
            images, rig, panorama, range_m, cloud.colors, caption=caption, half_m=cfg.bev_range_m
        )
        points = write_depth(folder, depth, panorama, cloud, overview)
    if show is not None:
        show(frame, images, rig, range_m, panorama)
    answered = float(depth.valid.float().mean())
    size, road = f"{panorama.width}x{panorama.height} px", ""
    if rig.road_z_m is not None:
        road = road_line(range_m, panorama, rig.road_z_m)
    facts = [size, f"{answered:.0%} with an answer", f"{points} points", *filter(None, [road])]
    return f"{folder}: {', '.join(facts)}; {watch}"
