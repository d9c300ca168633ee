"""Trained models whose predictions are shown."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float32, UInt8
from torch import Tensor

from omniocc.batch import Batch, Truth
from omniocc.camera import Rig
from omniocc.classes import UNKNOWN
from omniocc.data import OccupancyData
from omniocc.data.dataset import read_images
from omniocc.data.source import SceneFrames
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.reader import SceneReader
from omniocc.errors import UserError
from omniocc.geometry import Grid
from omniocc.model.ops.padded import to_unit_range
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.input.schedule import schedule
from omniocc.predict.input.sequence import true_range_m
from omniocc.predict.network import load_occupancy
from omniocc.predict.options import choose_device
from omniocc.predict.predictor import STEPS, Prediction, Predictor
from omniocc.predict.stopwatch import Stopwatch
from omniocc.predict.trained import TrainingData, facts_of, open_data
from omniocc.run.checkpoint_io import BEST, LAST, no_checkpoint
from omniocc.run.weights import find_checkpoint
from omniocc.task.scores import Scores
from omniocc.viewer.scenes import ChosenScenes

PixelLabels = tuple[np.ndarray, ...] | None
SAME_PIXELS = 0.25
"""Images whose number of pixels differs by less than this fraction from the training's are not scaled."""
FIGURES = {
    "rayiou": "rayiou",
    "rayiou@1": "rayiou@1",
    "rayiou@2": "rayiou@2",
    "rayiou@4": "rayiou@4",
    "lidar/rayiou": "lidar/rayiou",
    "voxel/iou": "iou",
    "voxel/miou": "miou",
}
"""Keys of `omniocc.task.scores.Scores` that are shown, and their names in a frame's figures."""


def find_run(given: str) -> Path:
    """Return the checkpoint of a run: a file, a run's folder (its best one, else its last), or shipped weights.

    Raises:
        FileNotFoundError: when there is none.
    """
    path = find_checkpoint(given)
    if path.is_dir():
        found = [path / name for name in (BEST, LAST) if (path / name).is_file()]
        if not found:
            raise FileNotFoundError(f"run={given}: the folder has neither {BEST} nor {LAST} (is it a run of train.py?)")
        return found[0]
    if not path.is_file():
        raise FileNotFoundError(no_checkpoint(path))
    return path


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A trained model with the data of its training.

    Attributes:
        name: of the run, unique among those shown.
        data: of its training, for its test scenes.
        trained: facts of its training.
        predictor: the model, which remembers past frames.
    """

    name: str
    data: OccupancyData
    trained: TrainingData
    predictor: Predictor

    @property
    def grid(self) -> Grid:
        """Return the grid of the predictions."""
        return self.predictor.model.geometry

    def predict(self, scene: SceneFrames, wanted: Sequence[int]) -> Iterator[tuple[Prediction, PixelLabels]]:
        """Return the predictions for the wanted frames of a scene, each with the history that it has in a test.

        With them come the classes of the pixels (see `FramePrediction.pixel_labels`).

        Raises:
            UserError: when images and model do not fit together.
        """
        predictor = self.predictor
        poses = torch.from_numpy(scene.world_from_ego)
        for lift in schedule(wanted, predictor.model.temporal.frames, "stream"):
            if lift.reset:
                predictor.reset()
            images, rig = self._input(scene, lift.frame)
            watch = Stopwatch(predictor.device, STEPS)
            pose, true_m = poses[lift.frame], true_range_m(scene, lift.frame)
            prediction = predictor.step_at_size(images, rig, pose, true_m, watch)
            if lift.wanted:
                yield prediction, self._pixel_labels(images, rig)

    def _input(self, scene: SceneFrames, frame: int) -> tuple[Float32[Tensor, "1 N 3 H W"], Rig]:
        """Return the images of a frame in [0, 1] and their rig, scaled unless about as large as in training."""
        rig, (width, height) = scene.rigs[frame], self.trained.image_size
        if abs(rig.cameras[0].width * rig.cameras[0].height / (width * height) - 1) < SAME_PIXELS:
            return to_unit_range(read_images(scene, frame)[None]), rig
        return resized_to_width(scene.images(frame), rig, self.trained.width_for(rig))

    @torch.inference_mode()
    def _pixel_labels(self, images: Float32[Tensor, "1 N 3 H W"], rig: Rig) -> PixelLabels:
        model = self.predictor.model
        logits = model.semantic_head(list(model.backbone(images.to(self.predictor.device))))
        if logits is None:
            return None
        stride, labels = model.backbone.levels[0], logits[0].argmax(1).to(torch.uint8).cpu().numpy()
        return tuple(
            mask_labels(one[: -(-camera.height // stride), : -(-camera.width // stride)], mask, stride)
            for one, camera, mask in zip(labels, rig.cameras, rig.each_mask, strict=True)
        )


def mask_labels(
    labels: UInt8[np.ndarray, "h w"], mask: Bool[Tensor, "H W"] | None, stride: int
) -> UInt8[np.ndarray, "h w"]:
    """Return labels of pixels of a stride, unknown where the image's mask is false in the middle of such a pixel."""
    if mask is None:
        return labels
    rows, columns = (
        np.minimum(np.arange(size) * stride + stride // 2, most - 1)
        for size, most in zip(labels.shape, mask.shape, strict=True)
    )
    return np.where(mask.numpy()[np.ix_(rows, columns)], labels, UNKNOWN).astype(np.uint8)


def load_models(runs: Sequence[str], names: Sequence[str], device: str | None) -> list[TrainedModel]:
    """Return the models of runs.

    Raises:
        FileNotFoundError, UserError: naming the run that cannot be used.
    """
    models = []
    for run, name in zip(runs, names, strict=True):
        path = find_run(run)
        model, cfg = load_occupancy(path)
        data = open_data(path, cfg)
        models.append(TrainedModel(name, data, facts_of(data, cfg), Predictor(model, None, (), choose_device(device))))
    return models


def check_classes(models: Sequence[TrainedModel], scenes: ChosenScenes) -> None:
    """Raise UserError if a model has other classes than the scenes."""
    names = scenes.spec.classes.names
    for model in models:
        own = model.trained.classes.names
        if own != names:
            raise UserError(
                f"'{model.name}' was trained with {len(own)} classes ({', '.join(own)}), the {scenes.source} have "
                f"{len(names)} ({', '.join(names)}): show them one after the other"
            )


def scene_scores(grid: Grid, scene: SceneReader) -> Scores:
    """Return empty scores of predictions on a grid for the frames of a recorded scene."""
    return Scores(grid, spec_of(scene))


def frame_figures(scores: Scores, labels: Tensor, truth: Batch | Truth) -> Mapping[str, float]:
    """Return the scores of one frame alone."""
    scores.reset()
    scores.update(labels[None], truth)
    found = scores.compute()
    return {name: float(found[key]) for key, name in FIGURES.items() if key in found}
