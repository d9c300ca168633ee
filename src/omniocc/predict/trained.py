"""Load a checkpoint: build its network, its data and the task that scores it, and predict from arrays."""

import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float16, Float32, UInt8
from omegaconf import DictConfig
from torch import nn

from omniocc.bounds import Probability, described, fits
from omniocc.camera import Equirectangular, Rig
from omniocc.config import OF_TRAINER
from omniocc.data import OccupancyData
from omniocc.data.formats.files import check_aspect
from omniocc.data.source import MadeScenes, SceneSource
from omniocc.data.store.files import is_url
from omniocc.errors import DataError, UserError
from omniocc.geometry import Grid
from omniocc.model import OccupancyModel
from omniocc.parts import TASK_KEYS, Parts
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.options import choose_device, load_rig
from omniocc.predict.output.voxel_files import raise_grid
from omniocc.predict.predictor import STEPS, Images, Input, Predictor, predict_depth
from omniocc.predict.road import WITHIN, on_road
from omniocc.predict.stopwatch import Stopwatch
from omniocc.predict.training_data import TrainingData
from omniocc.runs.checkpoint import (
    STAGES,
    Checkpoint,
    apply_overrides,
    check_parts,
    load_checkpoint,
    load_weights,
    part_weights,
)
from omniocc.runs.trust import building

if TYPE_CHECKING:
    from omniocc.train import OccupancyTask

PLACE_ARGUMENTS = ("root", "cache")
"""Arguments of a data source that name folders or URLs."""


class PredictedVoxels(NamedTuple):
    """Classes of the cells around a car.

    Attributes:
        labels: class of every cell, 0 free, 255 where no camera sees.
        probability: that the cell is occupied; and if it is, that it has its most likely class.
        grid: grid of the labels, in the ego frame of the given rig.
        names: names of the classes, by id.
        colors: RGB of the classes, by id.
    """

    labels: UInt8[np.ndarray, "X Y Z"]
    probability: Float16[np.ndarray, "2 X Y Z"]
    grid: Grid
    names: tuple[str, ...]
    colors: UInt8[np.ndarray, "K 3"]


class PredictedRanges(NamedTuple):
    """Ranges around a car.

    Attributes:
        range_m: distance along the ray of every pixel, m; nan where the network does not know it.
        panorama: camera that gives the direction of every pixel.
    """

    range_m: Float32[np.ndarray, "h w"]
    panorama: Equirectangular


def load(checkpoint: str | Path, overrides: Sequence[str] = (), packages: Sequence[str] = ()) -> "Trained":
    """Return the content of a checkpoint; its network and data are built when they are first used.

    Args:
        checkpoint: a file, the folder of a run (its best checkpoint, else its last), or the name of shipped weights.
        overrides: changes of its configuration, `key=value`.
        packages: further packages whose classes it may name.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when it is damaged or of an older version, or an override has no effect.
    """
    content = load_checkpoint(checkpoint)
    check_overrides(content.path, overrides, ("depth", "data", *TASK_KEYS))
    return Trained(content, apply_overrides(content.config, overrides), tuple(overrides), tuple(packages))


@dataclass(frozen=True, eq=False)
class Trained:
    """A checkpoint, whose parts (`depth`, `occupancy`, `task`, `data`) are built when they are first used.

    Each part of the configuration is checked before anything is built from it. A part raises UserError when the
    checkpoint does not hold it, its weights do not fit or are not finite, or the configuration names classes that are
    not offered. It raises ConfigError when the configuration does not fit this version.

    Attributes:
        checkpoint: content of the file, with the configuration of the training.
        config: that configuration with the overrides, resolved.
        overrides: changes of the configuration, `key=value`.
        packages: further packages whose classes may be built.
    """

    checkpoint: Checkpoint
    config: DictConfig
    overrides: tuple[str, ...]
    packages: tuple[str, ...]

    @property
    def path(self) -> Path:
        """Return the file of the checkpoint."""
        return self.checkpoint.path

    @property
    def stage(self) -> str:
        """Return the stage that was trained: `depth`, `sketch` or `occupancy`."""
        return self.checkpoint.stage

    @property
    def model(self) -> nn.Module:
        """Return the occupancy model, or the depth network if an earlier stage was trained."""
        return self.occupancy if self.stage == STAGES[-1] else self.depth

    @cached_property
    def depth(self) -> nn.Module:
        """Return the depth network in evaluation mode; checkpoints of every stage may hold one."""
        weights = part_weights(self.checkpoint, "depth")
        self._check("depth")
        with building(self.path, weights):
            depth = self._parts.without_pretrained().depth()
        return load_weights(depth, weights, self.path, "is it a depth network, are overrides needed?").eval()

    @cached_property
    def occupancy(self) -> OccupancyModel:
        """Return the occupancy model, sketch and depth included, in evaluation mode."""
        if self.stage != STAGES[-1]:
            raise UserError(
                f"{self.path} is a checkpoint of the {self.stage} stage; this needs one of the occupancy stage, "
                "such as runs/<name>-<hash>/best.ckpt"
            )
        check_overrides(self.path, self.overrides)
        self._check("model")
        weights = self.checkpoint.model_weights
        with building(self.path, weights):
            model = self._parts.without_pretrained().model()
        return load_weights(model, weights, self.path).eval()

    @cached_property
    def task(self) -> "OccupancyTask":
        """Return the occupancy model with its losses and scores, in evaluation mode."""
        from omniocc.train.build import build_task  # needs Lightning, whose import takes seconds

        model = self.occupancy  # built first, within limits of its own (`building`)
        self._check(*TASK_KEYS)
        with building(self.path, self.checkpoint.weights):
            task = build_task(self._parts.without_pretrained(), self.data.spec, model)
        task.occupied_above = self.occupied_above  # checked, since a file may hold anything
        return load_weights(task, self.checkpoint.weights, self.path).eval()

    @property
    def data(self) -> OccupancyData:
        """Return the data that the configuration names; no scene is read or made yet.

        Raises:
            UserError: also when the checkpoint names a place that it may not choose; see `check_places`.
        """
        check_places(self.path, self._data.source, {word.partition("=")[0] for word in self.overrides})
        self._data.check_classes()
        return self._data

    @cached_property
    def facts(self) -> TrainingData:
        """Return facts about the training's data; scenes are read only where the configuration does not suffice."""
        self._data.check_classes()
        return TrainingData.of(self._data, self.config)

    def predict_ranges(self, images: Images | UInt8[np.ndarray, "N H W 3"], rig: Rig | str | Path) -> PredictedRanges:
        """Return the ranges around a car from one frame, by the depth network of a checkpoint of any stage.

        Arguments and errors are those of `predict`. The panorama is around the origin of the rig.
        """
        rig = rig if isinstance(rig, Rig) else load_rig(str(rig))
        check_images(frame := list(images), rig)
        batch, scaled = resized_to_width(frame, rig, self.facts.width_for(rig))
        depth = on_road(predict_depth(self.depth, batch, scaled, choose_device(None)), self.depth, scaled, WITHIN)
        return PredictedRanges(depth.known_range_m()[0].numpy(), cast(Equirectangular, self.depth.panorama))

    def predict(
        self, images: Images | UInt8[np.ndarray, "N H W 3"], rig: Rig | str | Path
    ) -> PredictedVoxels | PredictedRanges:
        """Return the voxels around a car from one frame, or the ranges if only earlier stages were trained.

        Images are scaled to about as many pixels as the images of the training. All else is as in `predict.py`. If the
        road lies at another height than in the training, the grid moves with it; a line on stderr says so.

        Args:
            images: one array (H, W, 3) uint8 RGB of each camera, in the order of the rig.
            rig: the cameras, the name of a built-in rig, or a rig file.

        Raises:
            UserError: also when the rig cannot be used, the images do not fit it, or the network returns NaN.
        """
        if self.stage != STAGES[-1]:
            return self.predict_ranges(images, rig)
        rig = rig if isinstance(rig, Rig) else load_rig(str(rig))
        check_images(frame := list(images), rig)
        facts, device = self.facts, choose_device(None)
        width, classes = facts.width_for(rig), facts.classes
        placed, raised_m, message = facts.place(rig)
        lines = [f"road      {message}"] if message else []
        lines += [] if facts.has(rig) else [f"cameras   {facts.compare(rig)}"]
        print("".join(f"{line}\n" for line in lines), end="", file=sys.stderr, flush=True)
        predictor = Predictor(self.occupancy, width, (), device, self.occupied_above)
        found = predictor.step(Input(*predictor.scaled(frame, placed)), Stopwatch(device, STEPS)).without_unseen()
        grid, colors = raise_grid(self.occupancy.geometry, raised_m), classes.palette[: classes.num_classes]
        return PredictedVoxels(found.labels.numpy(), found.probability.numpy(), grid, classes.names, colors)

    @property
    def occupied_above(self) -> float | None:
        """Return the probability above which a cell counts as occupied; None: the most likely class counts."""
        value = self.config.get("occupied_above")
        if value is not None and not fits(value, Probability):
            raise UserError(f"{self.path} is damaged: occupied_above is not {described(Probability)}")
        return value

    @property
    def precision(self) -> str | int:
        """Return the number format of the training, such as `32-true` or `bf16-mixed`."""
        trainer, known = self.config.get("trainer"), OF_TRAINER["precision"]
        value: Any = trainer.get("precision") if isinstance(trainer, DictConfig) else None
        if not fits(value, known):
            raise UserError(f"{self.path} is damaged: trainer.precision is not {described(known)}")
        return value

    @cached_property
    def _data(self) -> OccupancyData:
        self._check("data")
        return self._parts.data()

    @property
    def _parts(self) -> Parts:
        return Parts(self.config)

    def _check(self, *parts: str) -> None:
        check_parts(self.path, self.config, parts, self.packages)


def check_images(images: Images, rig: Rig) -> None:
    """Raise UserError unless each camera has one array (H, W, 3) uint8 in the aspect ratio of its calibration."""
    if any(isinstance(image, str) for image in images):  # of a path the letters
        raise UserError(
            "images are files or a folder; give arrays (H, W, 3) uint8, or use python src/predict.py images=..."
        )
    if len(images) != len(rig.names):
        raise UserError(f"{len(images)} images for {len(rig.names)} cameras; give one each, of {', '.join(rig.names)}")
    for image, name, camera in zip(images, rig.names, rig.cameras, strict=True):
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            found = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
            raise UserError(f"camera '{name}': the image is {found}; give a numpy array (H, W, 3) uint8, RGB")
        try:
            check_aspect((image.shape[1], image.shape[0]), camera, f"camera '{name}'")
        except DataError as error:
            raise UserError(str(error)) from error


def check_places(path: Path, source: SceneSource, given: Collection[str]) -> None:
    """Check that a checkpoint fetches and makes data only in places that it may choose.

    These are the working folder, with all below it, and folders that already hold such data, so that runs of this
    machine find their data again.

    Args:
        path: of the checkpoint.
        source: source of scenes that was built from its configuration.
        given: keys that the user sets as overrides; their places are not checked.

    Raises:
        UserError: when another place is chosen; the message names it and the key that allows it.
    """
    for key in PLACE_ARGUMENTS:
        place = getattr(source, key, None)
        if place is None or f"data.source.{key}" in given:
            continue
        inside = not is_url(str(place)) and Path(place).resolve().is_relative_to(Path.cwd())
        # made scenes are written to a folder of their own below root; other sources only read root
        holder = source.folder if key == "cache" or isinstance(source, MadeScenes) else Path(place)
        if not inside and (is_url(str(place)) or not holder.exists()):
            raise UserError(
                f"{path} names {place} for its data, which is not below this folder and holds no such data; to use "
                f"it, name it yourself: data.source.{key}={place}"
            )


def check_overrides(path: Path, overrides: Sequence[str], parts: Sequence[str] = ("data", *TASK_KEYS)) -> None:
    """Check that each override of a checkpoint's configuration changes a single key of `parts`.

    Options (`model/sketch=...`), whole parts and the grid of the model cannot be changed.

    Raises:
        UserError: when an override does something else; the message names it and says what can be changed.
    """
    known = ", ".join(parts)
    for key in (word.partition("=")[0] for word in overrides):
        part = key.partition(".")[0]
        if "/" in key:
            raise UserError(
                f"{key}: {path} keeps the options that it was trained with; single keys of "
                f"{known} can be changed, such as data.source.root=..."
            )
        if part not in parts:
            raise UserError(
                f"{key}: this has no effect on {path}; only keys of {known} can be changed, "
                "such as data.source.root=..."
            )
        if key == part:
            raise UserError(
                f"{key}: {path} keeps its {part}, of which single keys can be changed, such as data.source.root=...; "
                "scenes of another source are scored by python src/predict.py occupancy checkpoint=... recorded=..."
            )
        if key.startswith("model.geometry"):
            raise UserError(f"{key}: {path} was trained on its grid and can have no other")
