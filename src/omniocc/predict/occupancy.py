"""The command `predict.py occupancy`: from a checkpoint and images to voxels in files."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from omniocc.classes import OCCUPANCY_CLASSES, ONE_CLASS
from omniocc.config import as_options
from omniocc.data.source import Ignore
from omniocc.data.store.files import is_url
from omniocc.data.store.shard import sha256
from omniocc.errors import UserError
from omniocc.model import OccupancyModel
from omniocc.predict.input.images import names_of
from omniocc.predict.input.own import OwnImages, own_images
from omniocc.predict.input.poses import read_poses
from omniocc.predict.input.schedule import History
from omniocc.predict.input.sequence import (
    FrameSequence,
    ImageSequence,
    RecordedSequence,
    find_scenes,
)
from omniocc.predict.job import Job, ShowFrame
from omniocc.predict.options import Options, choose_device
from omniocc.predict.output.bag import Bags, bag_path, run_into_bag, voxels_of
from omniocc.predict.output.manifest import OWN_RIG, pose_digest, write_manifest
from omniocc.predict.predictor import Predictor
from omniocc.predict.trained import Trained, load
from omniocc.predict.training_data import TrainingData
from omniocc.runs.results import PROTOCOL, save_results
from omniocc.runs.table import summary

if TYPE_CHECKING:
    from omniocc.scores import Scores

SAME_HEIGHT_M = 0.1
"""Heights of the road that differ by less are taken for the same."""


def options_of(cfg: DictConfig) -> Options:
    """Return the checked options.

    Raises:
        UserError: naming the option that is missing, contradictory or of the wrong type.
    """
    given = {str(key): value for key, value in cfg.items()}
    options = as_options(Options, "occupancy", given | {"exclude_cameras": names_of(cfg.exclude_cameras)})
    if (options.images is None) == (options.recorded is None):
        raise UserError("give either images=... (with rig=...), your own images, or recorded=..., recorded scenes")
    if options.images is None and (options.rig or options.poses or options.topics or options.road_z_m is not None):
        raise UserError(
            "rig=..., poses=..., topics=... and road_z_m=... belong to images=...; recorded scenes have their own"
        )
    if options.recorded is None and (options.scene or options.frames is not None):
        raise UserError("scene=... and frames=... belong to recorded=...; choose images by their folder")
    return options


def predict_occupancy(options: Options, show: ShowFrame | None = None, bags: Bags | None = None) -> None:
    """Find the frames, load the model, predict, write and show; print scores where there is ground truth.

    `bags` reads and writes ROS bags; without it they are refused.

    Raises:
        UserError, OSError: naming the option or file that cannot be used.
    """
    bag = bag_path(options.write_bag, bags)
    found = load(options.checkpoint)
    options = replace(options, checkpoint=str(found.path))
    with own_sequence(options, bags) as own:
        job, sequences = prepare(options, found, own, show)
        if bag is not None and len(sequences) > 1:
            raise UserError(f"write_bag={bag} takes one sequence of {len(sequences)}; choose one: scene=...")
        run_into_bag(lambda: job.run(sequences), bag, bags, lambda: voxels_of(job.output, sequences[0]))
    for line in job.summary():
        print(line, flush=True)
    if job.scores is not None:
        metrics = {f"test/{key}": float(value) for key, value in job.scores.compute().items()}
        frames = sum(len(sequence.wanted) for sequence in sequences)
        about = {"checkpoint": options.checkpoint, "data": options.recorded, "frames": frames}
        save_results(job.output, metrics, about | {PROTOCOL: job.scores.protocol()})
        print(f"{frames} frames: {figures(metrics)}; all figures: {job.output / 'table.md'}")


def prepare(
    options: Options, found: Trained, own: ImageSequence | None, show: ShowFrame | None
) -> tuple[Job, Sequence[FrameSequence]]:
    """Return the work and its sequences, announced and with the manifest of their folder.

    Raises:
        UserError, OSError: naming what does not exist or fit, or cannot be written.
    """
    model, trained = found.occupancy, found.facts
    sequences = with_classes_of(trained, sequences_of(options, own, trained))
    device = choose_device(options.device)
    history = choose_history(options, model, sequences)
    width = trained.width_for(sequences[0].rig) if options.image_width is None else options.image_width
    made_from = facts_of(options, sequences, history, width, trained.ignore)
    write_manifest(Path(options.output), made_from, options.force)
    if own is not None:
        own.rig.save(Path(options.output) / OWN_RIG)
    road = "" if own is None else trained.place(own.rig)[2]
    print("\n".join(announcement(options, model, trained, sequences, history, road)), flush=True)
    scores = scores_of(model, trained, sequences)
    above = found.occupied_above if options.occupied_above is None else options.occupied_above
    predictor = Predictor(model, width, options.exclude_cameras, device, above)
    return Job(predictor, history, trained, options, scores, show), sequences


def with_classes_of(trained: TrainingData, sequences: Sequence[FrameSequence]) -> Sequence[FrameSequence]:
    """Return the sequences; the ground truth of recorded ones without classes, and a line, if the training had none."""
    if trained.classes != OCCUPANCY_CLASSES:
        return sequences
    print(f"classes   {ONE_CLASS}", flush=True)
    return [replace(one, merged=True) if isinstance(one, RecordedSequence) else one for one in sequences]


def scores_of(model: OccupancyModel, trained: TrainingData, sequences: Sequence[FrameSequence]) -> "Scores | None":
    """Return the scores of recorded sequences, with their classes and bands; None for what has no ground truth.

    Raises:
        UserError: when their classes are not those of the model.
    """
    recorded = [sequence for sequence in sequences if isinstance(sequence, RecordedSequence) and sequence.labelled]
    for sequence in recorded:
        names = sequence.spec.classes.names
        if names != trained.classes.names:
            raise UserError(
                f"recorded={sequence.scene.folder} has {len(names)} classes ({', '.join(names)}), the model was "
                f"trained with {trained.classes.num_classes} ({', '.join(trained.classes.names)}): "
                "choose scenes with the classes of the model"
            )
    if not recorded:
        return None
    from omniocc.scores import Scores  # needs torchmetrics, whose import takes a second

    return Scores(model.geometry, recorded[0].spec)


def figures(metrics: Mapping[str, float]) -> str:
    """Return the model's row of `summary` in a line."""
    head, (model, *_) = summary(metrics)
    return ", ".join(f"{name} {value}" for name, value in zip(head[1:], model[1:], strict=True))


@contextmanager
def own_sequence(options: Options, bags: Bags | None) -> Iterator[ImageSequence | None]:
    """Give the sequence of a user's own images with its poses; None for recorded scenes.

    Raises:
        UserError, DataError: naming what does not exist or does not fit.
    """
    if options.images is None:
        yield None
        return
    given = OwnImages(*(getattr(options, key) for key in OwnImages._fields))
    with own_images(given, bags and bags.read) as own:
        if options.poses is not None:
            if own.frame_names[0] == "":
                raise UserError(f"poses={options.poses}: a single frame has no past; leave poses=... out")
            own = replace(own, world_from_ego=read_poses(Path(options.poses), own.frame_names))
        yield own


def sequences_of(options: Options, own: ImageSequence | None, trained: TrainingData) -> Sequence[FrameSequence]:
    """Return the sequences to predict; the user's own has its origin as high above the road as in training.

    Raises:
        UserError: naming what does not exist or does not fit.
    """
    if own is None:
        assert options.recorded is not None
        return find_scenes(Path(options.recorded), options.scene, options.frames, options.exclude_cameras)
    _, height_m, _ = trained.place(own.rig)
    return [own.raise_origin(height_m) if height_m else own]


def choose_history(options: Options, model: OccupancyModel, sequences: Sequence[FrameSequence]) -> History:
    """Return `history=...`; by default `stream` where the model fuses past frames and poses are known.

    Raises:
        UserError: when a history is asked for and poses are missing.
    """
    known = all(sequence.world_from_ego is not None for sequence in sequences)
    if options.history in ("stream", "window") and not known:
        raise UserError(f"history={options.history} needs the pose of every frame: poses=..., see --help")
    if options.history is not None:
        return options.history
    return "stream" if known and model.temporal.frames > 1 else "none"


def facts_of(
    options: Options, sequences: Sequence[FrameSequence], history: History, width: int | None, ignore: Ignore
) -> dict[str, Any]:
    """Return what the predictions are made from and how they are scored, for the manifest of their folder."""
    own = sequences[0] if isinstance(sequences[0], ImageSequence) else None
    more = {key: value for key in ("image_bits", "occupied_above") if (value := getattr(options, key)) is not None}
    if own is not None and own.topics is not None:
        more["topics"] = dict(own.topics)
    return {
        "checkpoint": sha256(Path(options.checkpoint))[:16],
        "images": places_of(options.recorded if own is None else options.images),
        "rig": None if own is None else own.rig.fingerprint[:16],
        "poses": None if own is None else pose_digest(own.world_from_ego),
        "history": history,
        "image_width": width,
        "exclude_cameras": list(options.exclude_cameras),
        "ignore": None if own is not None else ignore,
        **more,
    }


def places_of(given: str | Sequence[str] | None) -> str:
    """Return the files or folders that were given, wherever the command runs."""
    if isinstance(given, str):
        return given if is_url(given) else str(Path(given).resolve())
    return str([places_of(one) for one in given or ()])


def announcement(
    options: Options,
    model: OccupancyModel,
    trained: TrainingData,
    sequences: Sequence[FrameSequence],
    history: History,
    road: str,
) -> list[str]:
    """Return one line each about model, cameras, road (given; empty: none) and history."""
    grid = f"{type(model.geometry).__name__} {'x'.join(map(str, model.geometry.shape))}"
    past = model.temporal.frames - 1
    frames = f"{past} past frame{'s' * (past != 1)}"
    parameters = sum(parameter.numel() for parameter in model.parameters()) / 1e6
    if history != "none":
        used = f"{history}: up to {frames}"
    elif not past:
        used = "none: the model fuses no past frames"
    elif sequences[0].world_from_ego is None:
        used = f"off: without poses=... each frame is predicted alone; the model was trained with {frames}"
    else:
        used = f"off, as requested; the model was trained with {frames}"
    return [
        f"model     {options.checkpoint}, {parameters:.2f} M parameters, {grid}",
        f"cameras   {', '.join(sequences[0].rig.names)}: {trained.compare(sequences[0].rig)}",
        *([f"road      {road}"] if road else []),
        *other_heights(sequences, trained),
        f"history   {used}",
    ]


def other_heights(sequences: Sequence[FrameSequence], trained: TrainingData) -> list[str]:
    """Return a line where recorded scenes have the road at another height than the model had in its training."""
    for one in (sequence for sequence in sequences if isinstance(sequence, RecordedSequence)):
        road_z_m, trained_z_m = one.road_z_m, trained.road_z_m
        if road_z_m is None or trained_z_m is None:
            continue
        if abs(road_z_m - trained_z_m) >= SAME_HEIGHT_M:
            of_log = "log" in one.scene.meta.get("facts", {})
            remedy = f"; record it with recorder.origin_above_road_m={-trained_z_m:g}" if of_log else ""
            return [
                f"road      {-road_z_m:g} m below the origin of {one.name}, {-trained_z_m:g} m in the training: "
                f"expect wrong voxels{remedy}"
            ]
    return []
