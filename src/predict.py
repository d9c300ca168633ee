"""What a trained model says about your own pictures: `python src/predict.py {depth,occupancy} rig=... images=...`.

`python src/predict.py occupancy --help` says more.
"""

import itertools
import sys
import time
from pathlib import Path
from typing import cast

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, ListConfig, OmegaConf
from torch import nn

from omniocc.camera import Equirectangular, Rig
from omniocc.config import build, check
from omniocc.errors import UserError
from omniocc.predict import (
    Frame,
    cloud_of,
    find_frames,
    load_depth,
    predict_depth,
    read_frame,
    resized_to_width,
    write_depth,
)
from omniocc.predict.network import trained_image_width
from omniocc.predict.occupancy import options_of, predict_occupancy
from omniocc.run.script import quiet_libraries, script
from omniocc.view import predicted_sheet


@script("predict_depth")
def depth(cfg: DictConfig) -> None:
    """Check -> build -> one folder of files per frame."""
    run(cfg, [str(override) for override in HydraConfig.get().overrides.task])


@script("predict_occupancy")
def occupancy(cfg: DictConfig) -> None:
    """Check -> build -> one folder of files per moment."""
    quiet_libraries()
    predict_occupancy(options_of(cfg))


def run(cfg: DictConfig, overrides: list[str]) -> None:
    """The command, given its configuration and what of it was said on the command line."""
    for key in ("rig", "images"):
        if OmegaConf.is_missing(cfg, key):
            raise UserError(f"{key}=... is needed; see python src/predict.py depth --help")
    rig = load_rig(cfg.rig)
    images = [str(path) for path in cfg.images] if isinstance(cfg.images, ListConfig) else str(cfg.images)
    frames = find_frames(images, rig, [str(name) for name in cfg.without])
    model, image_width = chosen_model(cfg, overrides)
    device = torch.device(cfg.device or ("cuda" if torch.cuda.is_available() else "cpu"))
    for frame in frames:
        folder = Path(cfg.output) / frame.name
        print(predict_frame(frame, folder, model, rig, image_width, cfg.reach_m, device), flush=True)


def load_rig(path: str) -> Rig:
    """`Rig.load`, whose complaints are the user's."""
    try:
        return Rig.load(path)
    except ValueError as error:
        raise UserError(f"rig={path}: {error}") from error


def chosen_model(cfg: DictConfig, overrides: list[str]) -> tuple[nn.Module, int | None]:
    """The depth option and the width of pictures it is used to."""
    if cfg.checkpoint is None:
        check(OmegaConf.create({"depth": OmegaConf.to_container(cfg.depth, resolve=True)}))
        return build(cfg.depth).eval(), cfg.image_width
    overrides = [text.lstrip("+") for text in overrides]
    foreign = [text for text in overrides if text.startswith(("model/", "preset", "depth="))]
    if foreign:
        raise UserError(f"{foreign[0]}: the checkpoint knows its own; leave it out, or leave out the checkpoint")
    model, trained = load_depth(Path(cfg.checkpoint), [text for text in overrides if text.startswith("depth.")])
    chosen = any(text.startswith("image_width=") for text in overrides)
    return model, cfg.image_width if chosen else trained_image_width(trained)


def predict_frame(
    frame: Frame,
    folder: Path,
    model: nn.Module,
    rig: Rig,
    image_width: int | None,
    reach_m: float,
    device: torch.device,
) -> str:
    """Predict and write one frame; a line about it."""
    times_s = [time.perf_counter()]
    images = read_frame(frame, rig)
    batch, scaled = resized_to_width(images, rig, image_width)
    times_s.append(time.perf_counter())
    answer = predict_depth(model, batch, scaled, device)
    times_s.append(time.perf_counter())
    range_m, panorama = answer.known_range_m()[0], cast(Equirectangular, model.panorama)
    cloud = cloud_of(range_m, panorama, images, rig)
    missing = [name for name, file in zip(rig.names, frame.files, strict=True) if file is None]
    caption = " ".join([frame.name, f"without {', '.join(missing)}" if missing else ""]).strip()
    picture = predicted_sheet(images, rig, panorama, range_m, cloud.colors, caption, reach_m)
    points = write_depth(folder, answer, panorama, cloud, picture)
    times_s.append(time.perf_counter())
    read, net, write = (b - a for a, b in itertools.pairwise(times_s))
    share = float(answer.valid.float().mean())
    return (
        f"{folder}: {panorama.width}x{panorama.height} px, {share:.0%} with an answer, {points} points; "
        f"read {read:.2f} s, depth {net:.2f} s, write {write:.2f} s"
    )


COMMANDS = {"depth": depth, "occupancy": occupancy}


def main() -> None:
    """Hand over to the command that the first argument names."""
    if len(sys.argv) < 2 or sys.argv[1] not in COMMANDS:
        asked = len(sys.argv) > 1 and sys.argv[1] in ("-h", "--help")
        print(f"usage: python src/predict.py {{{','.join(COMMANDS)}}} key=value ...    (occupancy --help says more)")
        sys.exit(0 if asked else 2)
    COMMANDS[sys.argv.pop(1)]()


if __name__ == "__main__":
    main()
