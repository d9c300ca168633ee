"""The command `predict.py depth`: from a calibrated rig's images to range panoramas in files."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
import torch
from jaxtyping import Float32
from omegaconf import DictConfig, ListConfig, OmegaConf
from torch import Tensor, nn

from omniocc.bounds import Within
from omniocc.camera import Equirectangular, Rig
from omniocc.config import check, check_values
from omniocc.draw import predicted_sheet
from omniocc.errors import UserError
from omniocc.parts import Parts
from omniocc.predict.input.images import names_of, resized_to_width
from omniocc.predict.input.own import OwnImages, own_images
from omniocc.predict.input.sequence import ImageSequence
from omniocc.predict.options import choose_device
from omniocc.predict.output.bag import Bags, bag_path, ranges_of, run_into_bag
from omniocc.predict.output.range_files import OVERVIEW, RANGES, point_cloud, write_depth
from omniocc.predict.predictor import predict_depth
from omniocc.predict.road import NO_ROAD, check_within, on_road, road_line
from omniocc.predict.stopwatch import Stopwatch
from omniocc.predict.trained import load
from omniocc.progress import Progress

SWEEP = "sweep"
"""Value of `checkpoint` that chooses the option of `model/depth`, without weights, as null does."""

HALF_M = Annotated[float, Within(0, 1000, open_low=True)]
"""Half the edge length of a bird's-eye view, m."""

ShowRanges = Callable[[str, Sequence[np.ndarray], Rig, Float32[Tensor, "h w"], Equirectangular], None]
"""Shows the panorama of one frame: given the frame's name, its images, their rig, the ranges and their directions."""


def predict_panoramas(
    cfg: DictConfig, overrides: Sequence[str], show: ShowRanges | None = None, bags: Bags | None = None
) -> None:
    """Predict every frame, write its folder of files and show it; `cfg` is composed from `conf/predict_depth.yaml`.

    `bags` reads and writes ROS bags; without it they are refused.

    Raises:
        UserError, FileNotFoundError: naming the option, file or checkpoint that cannot be used.
    """
    bag = bag_path(cfg.write_bag, bags)
    texts = {"images": str | Sequence[str], "output": str, "rig": str | None}
    check_values(cfg, {**texts, "image_width": int | None, "image_bits": int | None, "bev_range_m": HALF_M})
    cfg.exclude_cameras = names_of(cfg.exclude_cameras)
    given = OwnImages(*(_plain(cfg[key]) for key in OwnImages._fields))
    with own_images(given, bags and bags.read) as sequence:
        rig = sequence.rig
        check_within(cfg.road_within)
        model, image_width = choose_model(cfg, overrides, rig)
        if rig.road_z_m is None and getattr(model, "hints", False):
            print(f"road      {NO_ROAD}", flush=True)
        device = choose_device(cfg.device)
        if line := others_line(Path(cfg.output), sequence.frame_names):
            print(line, flush=True)
        progress = Progress(f"predicting into {cfg.output}", len(sequence.frame_names))

        def run() -> None:
            with progress:
                for frame in sequence.wanted:
                    print(predict_frame(cfg, sequence, frame, model, image_width, device=device, show=show), flush=True)
                    progress.advance()

        run_into_bag(run, bag, bags, lambda: ranges_of(Path(cfg.output), sequence, progress.done))


def others_line(output: Path, names: Sequence[str]) -> str:
    """Return a line on the ranges in a folder that are of other frames than these; empty without any."""
    kept = {output / name for name in names}
    others = sorted(path.parent for path in [*output.glob(RANGES), *output.glob(f"*/{RANGES}")])
    others = [str(folder) for folder in others if folder not in kept]
    if not others:
        return ""
    shown = ", ".join(others[:3]) + ", ..." * (len(others) > 3)
    frames = f"{len(others)} other frame{'s' * (len(others) != 1)}"
    return f"output    ranges of {frames} stay beside the new ones: {shown}; remove them, or choose another output=..."


def _plain(value: Any) -> Any:
    return [str(one) for one in value] if isinstance(value, ListConfig) else value


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
    sequence: ImageSequence,
    frame: int,
    model: nn.Module,
    image_width: int | None,
    device: torch.device,
    show: ShowRanges | None,
) -> str:
    """Predict one frame, write its files, show it, and return a line about it."""
    rig, name = sequence.rig, sequence.frame_names[frame]
    folder = Path(cfg.output) / name
    watch = Stopwatch(device, ("read", "depth", "write"))
    with watch("read"):
        images = sequence.images(frame)
        batch, scaled = resized_to_width(images, rig, image_width)
    with watch("depth"):
        depth = on_road(predict_depth(model, batch, scaled, device), model, scaled, cfg.road_within)
    with watch("write"):
        range_m, panorama = depth.known_range_m()[0], cast(Equirectangular, model.panorama)
        cloud = point_cloud(range_m, panorama, images, rig)
        missing = [camera for camera in rig.names if camera in cfg.exclude_cameras]
        caption = " ".join([name, f"without {', '.join(missing)}" if missing else ""]).strip()
        overview = predicted_sheet(
            images, rig, panorama, range_m, cloud.colors, caption=caption, half_m=cfg.bev_range_m
        )
        points = write_depth(folder, depth, panorama, cloud, overview)
    if show is not None:
        show(name, images, rig, range_m, panorama)
    answered = float(depth.valid.float().mean())
    size, road = f"{panorama.width}x{panorama.height} px", ""
    if rig.road_z_m is not None:
        road = road_line(range_m, panorama, rig.road_z_m)
    facts = [size, f"{answered:.0%} with an answer", f"{points} points", *filter(None, [road])]
    return f"{folder / OVERVIEW}: {', '.join(facts)}; {watch}"
