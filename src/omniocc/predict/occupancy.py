"""The command `predict.py occupancy`: from a checkpoint and pictures to voxels in files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf

from omniocc.camera import Rig
from omniocc.config import build, check
from omniocc.data.source.recorded import spec_of
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.model import OccupancyModel
from omniocc.predict.export import RIG
from omniocc.predict.input.images import check_without, find_frames
from omniocc.predict.input.poses import read_poses
from omniocc.predict.input.schedule import History
from omniocc.predict.input.sequence import Drive, PictureDrive, RecordedDrive, find_scenes
from omniocc.predict.job import Job
from omniocc.predict.network import load_occupancy, trained_image_width
from omniocc.predict.output.claim import claim, digest_of, fingerprint_of_poses
from omniocc.predict.predictor import Predictor
from omniocc.run.results import save_results
from omniocc.run.table import summary
from omniocc.task.scores import Scores

TRAINED_ROAD_Z_M = -2.2
"""Where the road lies in the ego frame of recorded scenes."""


@dataclass(frozen=True)
class Options:
    """What can be said on the command line; see `conf/predict_occupancy.yaml`."""

    checkpoint: str
    images: str | Sequence[str] | None
    rig: str | None
    poses: str | None
    road_z_m: float | None
    recorded: str | None
    scene: str | None
    frames: Sequence[int] | None
    history: History | None
    output: str
    force: bool
    picture: bool
    mesh: bool
    without: Sequence[str]
    image_width: int | None
    device: str | None


def options_of(cfg: DictConfig) -> Options:
    """The checked options.

    Raises:
        UserError: naming what is missing, contradictory or of the wrong kind.
    """
    if OmegaConf.is_missing(cfg, "checkpoint"):
        raise UserError(
            "checkpoint=... is needed, such as runs/<name>-<hash>/best.ckpt; see predict.py occupancy --help"
        )
    node = OmegaConf.create({"occupancy": {"_target_": f"{__name__}.Options", **cfg}})
    check(node)
    options: Options = build(node.occupancy)
    if (options.images is None) == (options.recorded is None):
        raise UserError("give either images=... (with rig=...), your own pictures, or recorded=..., rendered scenes")
    if options.images is None and (options.rig or options.poses or options.road_z_m is not None):
        raise UserError("rig=..., poses=... and road_z_m=... go with images=...; recorded scenes have their own")
    if options.recorded is None and (options.scene or options.frames is not None):
        raise UserError("scene=... and frames=... go with recorded=...; choose pictures by their folder")
    if not Path(options.checkpoint).is_file():
        raise FileNotFoundError(f"{options.checkpoint}: there is no such checkpoint")
    return options


def predict_occupancy(options: Options) -> None:
    """Find -> load -> predict and write -> figures, where the truth is known.

    Raises:
        UserError, OSError: whose message is all a user needs.
    """
    drives, device = drives_of(options), chosen_device(options.device)
    model, cfg = load_occupancy(Path(options.checkpoint))
    history = chosen_history(options, model, drives)
    width = trained_image_width(cfg) if options.image_width is None else options.image_width
    output = Path(options.output)
    claim(output, facts_of(options, drives, history, width), options.force)
    print("\n".join(announcement(options, model, cfg, drives, history)), flush=True)
    scores = Scores(model.geometry, spec_of(drives[0].scene)) if isinstance(drives[0], RecordedDrive) else None
    job = Job(
        Predictor(model, width, options.without, device),
        history,
        cfg.data.unknown,
        output,
        options.force,
        options.mesh,
        options.picture,
        scores,
    )
    job.run(drives)
    print("\n".join(job.summary()), flush=True)
    if scores is not None:
        metrics = {f"test/{key}": float(value) for key, value in scores.compute().items()}
        frames = sum(len(drive.wanted) for drive in drives)
        save_results(output, metrics, {"checkpoint": options.checkpoint, "data": options.recorded, "frames": frames})
        print(f"{frames} frames: {figures(metrics)}; all figures: {output / 'table.md'}")


def figures(metrics: Mapping[str, float]) -> str:
    """The first of them in a line."""
    head, (model, *_) = summary(metrics)
    return ", ".join(f"{name} {value}" for name, value in zip(head[1:], model[1:], strict=True))


def drives_of(options: Options) -> Sequence[Drive]:
    """Where the pictures come from.

    Raises:
        UserError: naming what is not there or does not fit.
    """
    if options.recorded is not None:
        drives = find_scenes(Path(options.recorded), options.scene, options.frames)
        check_without(options.without, drives[0].rig)
        return drives
    assert options.images is not None
    rig = rig_of(options)
    images = options.images if isinstance(options.images, str) else list(options.images)
    frames = tuple(find_frames(images, rig, options.without))
    poses = None
    if options.poses is not None:
        if frames[0].name == "":
            raise UserError(f"poses={options.poses}: a single moment has no past; leave poses=... out")
        poses = read_poses(Path(options.poses), [frame.name for frame in frames])
    drive = PictureDrive(rig, frames, poses)
    return [drive if options.road_z_m is None else drive.raised(options.road_z_m - TRAINED_ROAD_Z_M)]


def rig_of(options: Options) -> Rig:
    """The calibrated cameras of the pictures."""
    if options.rig is None:
        beside = Path(options.images) / RIG if isinstance(options.images, str) else Path(RIG)
        hint = f"; there is {beside}" if beside.is_file() else ""
        raise UserError(f"rig=... is needed: a rig file, a calibration or a built-in rig{hint}")
    try:
        return Rig.load(options.rig)
    except ValueError as error:
        raise UserError(f"rig={options.rig}: {error}") from error


def chosen_history(options: Options, model: OccupancyModel, drives: Sequence[Drive]) -> History:
    """As asked for; by default the past is used where the model fuses it and poses are known."""
    known = all(drive.world_from_ego is not None for drive in drives)
    if options.history in ("stream", "window") and not known:
        raise UserError(f"history={options.history} needs the pose of every moment: poses=..., see --help")
    if options.history is not None:
        return options.history
    return "stream" if known and model.temporal.frames > 1 else "none"


def facts_of(
    options: Options, drives: Sequence[Drive], history: History, width: int | None
) -> dict[str, str | int | Sequence[str] | None]:
    """What makes the answers, for the folder that holds them."""
    own = drives[0] if options.recorded is None else None
    return {
        "checkpoint": digest_of(Path(options.checkpoint)),
        "pictures": str(options.recorded if own is None else options.images),
        "rig": None if own is None else own.rig.fingerprint[:16],
        "poses": None if own is None else fingerprint_of_poses(own.world_from_ego),
        "history": history,
        "image_width": width,
        "without": list(options.without),
    }


def chosen_device(name: str | None) -> torch.device:
    """The one asked for, or the GPU if there is one.

    Raises:
        UserError: for a device that is not there.
    """
    try:
        device = torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UserError(f"device={name}: {str(error).splitlines()[0]}; use cpu or cuda") from error
    return device


def announcement(
    options: Options, model: OccupancyModel, cfg: DictConfig, drives: Sequence[Drive], history: History
) -> list[str]:
    """A line each about model, cameras and history."""
    grid, past = model.geometry, model.temporal.frames - 1
    parameters = sum(parameter.numel() for parameter in model.parameters()) / 1e6
    if history != "none":
        used = f"{history}: up to {past} past moments"
    elif not past:
        used = "none: the model fuses no past moments"
    elif drives[0].world_from_ego is None:
        used = f"off: without poses=... each moment is predicted alone; the model was trained with {past} past ones"
    else:
        used = f"off, as asked for; the model was trained with {past} past moments"
    return [
        f"model     {options.checkpoint}, {parameters:.2f} M parameters, {describe(grid)}",
        f"cameras   {', '.join(drives[0].rig.names)}: {compared_rig(drives[0].rig, cfg)}",
        f"history   {used}",
    ]


def describe(grid: Grid) -> str:
    """Kind and shape."""
    return f"{type(grid).__name__} {'x'.join(map(str, grid.shape))}"


def compared_rig(rig: Rig, cfg: DictConfig) -> str:
    """Whether these are the cameras that the model was trained with."""
    name, size = OmegaConf.select(cfg, "data.source.rig"), OmegaConf.select(cfg, "data.source.image_size")
    if name is None:
        return "trained with the cameras of recorded scenes"
    try:
        trained = Rig.load(name)
        same = rig.resized(*size) == trained.resized(*size)
    except ValueError:  # the rig file of the training is elsewhere, or a lens cannot be brought to that size
        return f"trained with {name}"
    return "as in training" if same else f"others than in training ({name}), so expect less"
