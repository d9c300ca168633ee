"""From a checkpoint to what was trained: the network, the data, the task that scores it, predictions for arrays."""

import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Float32, UInt8
from omegaconf import DictConfig
from torch import nn

from omniocc.camera import Equirectangular, Rig
from omniocc.data import OccupancyData
from omniocc.data.formats.files import check_aspect
from omniocc.data.source import MadeScenes, SceneSource
from omniocc.data.store.files import is_url
from omniocc.errors import DataError, UserError
from omniocc.geometry import Grid
from omniocc.model import OccupancyModel
from omniocc.parts import OF_TASK, Parts
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.options import choose_device, load_rig
from omniocc.predict.output.voxel_files import raise_grid
from omniocc.predict.predictor import STEPS, Images, Input, Predictor, predict_depth
from omniocc.predict.road import WITHIN, on_road
from omniocc.predict.stopwatch import Stopwatch
from omniocc.predict.training_data import TrainingData
from omniocc.runs.checkpoint import (
    Checkpoint,
    check_parts,
    load_checkpoint,
    load_weights,
    part_weights,
    with_overrides,
)
from omniocc.runs.trust import building
from omniocc.train import OccupancyTask
from omniocc.train.build import build_task

PLACES = ("root", "cache")
"""Arguments of a data source that name folders or URLs."""


class PredictedVoxels(NamedTuple):
    """Classes of the cells around a car.

    Attributes:
        labels: class of every cell, 0 free.
        grid: of the labels, in the frame of the rig that was given.
        names: of the classes.
        colors: RGB of the classes.
    """

    labels: UInt8[np.ndarray, "X Y Z"]
    grid: Grid
    names: tuple[str, ...]
    colors: UInt8[np.ndarray, "K 3"]


class PredictedRanges(NamedTuple):
    """Ranges around a car.

    Attributes:
        range_m: distance along the ray of every pixel, m, nan without an answer.
        panorama: directions of the pixels.
    """

    range_m: Float32[np.ndarray, "h w"]
    panorama: Equirectangular


def load(checkpoint: str | Path, overrides: Sequence[str] = (), packages: Sequence[str] = ()) -> "Trained":
    """Return what was trained in a checkpoint; its parts are built when they are asked for.

    Args:
        checkpoint: a file, a run's folder (its best checkpoint, else its last), or the name of shipped weights.
        overrides: of its configuration, `key=value`.
        packages: whose classes it may name beside those of this platform.

    Raises:
        FileNotFoundError: when there is no such file.
        UserError: when it is damaged or of an older version, or an override has no effect.
    """
    content = load_checkpoint(checkpoint)
    check_changes(content.path, overrides, ("depth", "data", *OF_TASK))
    return Trained(content, with_overrides(content.config, overrides), tuple(overrides), tuple(packages))


@dataclass(frozen=True, eq=False)
class Trained:
    """What a checkpoint holds. Every part of its configuration is checked before anything is built from it.

    All parts raise UserError when the checkpoint holds none, when its weights do not fit or are not finite, or when the
    configuration names classes that are not offered; and ConfigError when it does not fit this version.

    Attributes:
        checkpoint: content of the file, with the configuration of the training.
        config: that configuration with the overrides, resolved.
        overrides: `key=value`.
        packages: whose classes may be built beside those of this platform.
    """

    checkpoint: Checkpoint
    config: DictConfig
    overrides: tuple[str, ...]
    packages: tuple[str, ...]

    @property
    def path(self) -> Path:
        """Return the file."""
        return self.checkpoint.path

    @property
    def stage(self) -> str:
        """Return what was trained: `depth`, `sketch` or `occupancy`."""
        return self.checkpoint.stage

    @property
    def model(self) -> nn.Module:
        """Return the occupancy model; of earlier stages the depth network."""
        return self.occupancy if self.stage == OccupancyTask.STAGE else self.depth

    @cached_property
    def depth(self) -> nn.Module:
        """Return the depth network, of any stage, in evaluation mode."""
        own = part_weights(self.checkpoint, "depth")
        self._check("depth")
        with building(self.path, own):
            depth = self._parts.depth()
        return load_weights(depth, own, self.path, "is it a depth network, are overrides needed?").eval()

    @cached_property
    def occupancy(self) -> OccupancyModel:
        """Return the occupancy model, sketch and depth included, in evaluation mode."""
        if self.stage != OccupancyTask.STAGE:
            raise UserError(
                f"{self.path} is a checkpoint of the {self.stage} stage; this needs one of the occupancy stage, "
                "such as runs/<name>-<hash>/best.ckpt"
            )
        check_changes(self.path, self.overrides)
        self._check("model")
        own = self.checkpoint.model_weights
        with building(self.path, own):
            model = self._parts.without_pretrained().model()
        return load_weights(model, own, self.path).eval()

    @cached_property
    def task(self) -> OccupancyTask:
        """Return the occupancy model with its losses and scores, in evaluation mode."""
        model = self.occupancy  # which is built within limits of its own
        self._check(*OF_TASK)
        with building(self.path, self.checkpoint.weights):
            task = build_task(self._parts.without_pretrained(), self.data.spec, model)
        return load_weights(task, self.checkpoint.weights, self.path).eval()

    @property
    def data(self) -> OccupancyData:
        """Return the data of its configuration; nothing is read or made.

        Raises:
            UserError: also when the file chooses a place for them that it may not choose; see `check_places`.
        """
        check_places(self.path, self._data.source, {word.partition("=")[0] for word in self.overrides})
        self._data.check_classes()
        return self._data

    @cached_property
    def facts(self) -> TrainingData:
        """Return what is known of the training's data, without any of its scenes where the configuration suffices."""
        self._data.check_classes()
        return TrainingData.of(self._data, self.config)

    def predict(
        self, images: Images | UInt8[np.ndarray, "N H W 3"], rig: Rig | str | Path
    ) -> PredictedVoxels | PredictedRanges:
        """Return the voxels around a car, or the ranges if only a depth network was trained, from one frame.

        Images are scaled to about as many pixels as those of the training; all else is as `predict.py` does it. A line
        on stderr says if the grid moves because the road lies at another height than in the training.

        Args:
            images: (H, W, 3) uint8 RGB of every camera, in the rig's order.
            rig: the cameras, the name of a built-in rig, or a rig file.

        Raises:
            UserError: also when the rig cannot be used, the images do not fit it, or the network returns NaN.
        """
        rig = rig if isinstance(rig, Rig) else load_rig(str(rig))
        check_images(listed := list(images), rig)
        facts, device = self.facts, choose_device(None)
        width, classes = facts.width_for(rig), facts.classes
        if self.stage != OccupancyTask.STAGE:
            batch, scaled = resized_to_width(listed, rig, width)
            depth = on_road(predict_depth(self.depth, batch, scaled, device), self.depth, scaled, WITHIN)
            return PredictedRanges(depth.known_range_m()[0].numpy(), cast(Equirectangular, self.depth.panorama))
        placed, height_m, line = facts.place(rig)
        if line:
            print(f"road      {line}", file=sys.stderr, flush=True)
        predictor = Predictor(self.occupancy, width, (), device)
        found = predictor.step(Input(*predictor.scaled(listed, placed)), Stopwatch(device, STEPS))
        grid, colors = raise_grid(self.occupancy.geometry, height_m), classes.palette[: classes.num_classes]
        return PredictedVoxels(found.labels.numpy(), grid, classes.names, colors)

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
    """Raise UserError unless each camera has one array (H, W, 3) uint8 of the aspect ratio of its calibration."""
    if len(images) != len(rig.names):
        raise UserError(f"{len(images)} images for {len(rig.names)} cameras; give one each, of {', '.join(rig.names)}")
    for image, name, camera in zip(images, rig.names, rig.cameras, strict=True):
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            what = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
            raise UserError(f"camera '{name}': the image is {what}; give a numpy array (H, W, 3) uint8, RGB")
        try:
            check_aspect((image.shape[1], image.shape[0]), camera, f"camera '{name}'")
        except DataError as error:
            raise UserError(str(error)) from error


def check_places(path: Path, source: SceneSource, given: Collection[str]) -> None:
    """Check that a file does not choose where data are fetched from or made, except below the working folder.

    Folders that exist are taken as they are, so that runs of this machine find their data again.

    Args:
        path: of the checkpoint.
        source: built from its configuration.
        given: keys that the command line sets, which may be anywhere.

    Raises:
        UserError: naming the place and the key that allows it.
    """
    for key in PLACES:
        place = getattr(source, key, None)
        if place is None or f"data.source.{key}" in given:
            continue
        inside = not is_url(str(place)) and Path(place).resolve().is_relative_to(Path.cwd())
        # scenes that are made go into a new folder of root, other sources only read there
        holds = source.folder if key == "cache" or isinstance(source, MadeScenes) else Path(place)
        if not inside and (is_url(str(place)) or not holds.exists()):
            raise UserError(
                f"{path} names {place} for its data, which is not below this folder and holds no such data; to use "
                f"it, name it yourself: data.source.{key}={place}"
            )


def check_changes(path: Path, overrides: Sequence[str], parts: Sequence[str] = ("data", *OF_TASK)) -> None:
    """Check that overrides of a checkpoint's configuration have an effect on `parts`, and only the one that is meant.

    Raises:
        UserError: naming the override, and what to do instead.
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
