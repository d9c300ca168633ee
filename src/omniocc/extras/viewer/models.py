"""Trained models whose predictions are shown."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Bool, Float32, UInt8
from torch import Tensor

from omniocc.batch import Batch, Truth
from omniocc.camera import Rig
from omniocc.classes import UNKNOWN
from omniocc.data.dataset import read_images
from omniocc.data.source import SceneFrames, SourceSpec
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.reader import SceneReader
from omniocc.errors import UserError
from omniocc.extras.viewer.scenes import ChosenScenes
from omniocc.geometry import Grid
from omniocc.model.ops.padded import to_unit_range
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.input.sequence import true_range_m
from omniocc.predict.predictor import Input, PredictedFrame, Predictor
from omniocc.predict.trained import Trained

if TYPE_CHECKING:
    from omniocc.scores import Scores

PixelLabels = tuple[np.ndarray, ...] | None
SAME_PIXELS = 0.25
"""Images whose number of pixels differs by less than this fraction from the training's are not scaled."""
FIGURES = ("rayiou", "rayiou@1", "rayiou@2", "rayiou@4", "lidar/rayiou", "voxel/iou", "voxel/miou")
"""Keys of `omniocc.scores.Scores` that are shown of a frame, without `voxel/`."""


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A trained model that is shown.

    Attributes:
        name: of the run, unique among those shown.
        trained: the model with the data of its training.
        predictor: the model, which remembers past frames.
    """

    name: str
    trained: Trained
    predictor: Predictor

    @property
    def grid(self) -> Grid:
        """Return the grid of the predictions."""
        return self.predictor.model.geometry

    def predict(self, scene: SceneFrames, wanted: Sequence[int]) -> Iterator[tuple[PredictedFrame, PixelLabels]]:
        """Return the predictions for the wanted frames of a scene, each with the history that it has in a test.

        With them come the classes of the pixels (see `FramePrediction.pixel_labels`).

        Raises:
            UserError: when images and model do not fit together.
        """
        for _, given, prediction, _ in self.predictor.frames(wanted, "stream", partial(self._read, scene)):
            yield prediction, self._pixel_labels(given.images, given.rig)

    def _read(self, scene: SceneFrames, frame: int) -> Input:
        """Return a frame, its images scaled unless they are about as large as in training."""
        pose, true_m = torch.from_numpy(scene.world_from_ego[frame]), true_range_m(scene, frame)
        rig, (width, height) = scene.rigs[frame], self.trained.facts.image_size
        if abs(rig.cameras[0].width * rig.cameras[0].height / (width * height) - 1) < SAME_PIXELS:
            return Input(to_unit_range(read_images(scene, frame)[None]), rig, pose, true_m)
        return Input(*resized_to_width(scene.images(frame), rig, self.trained.facts.width_for(rig)), pose, true_m)

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
    """Return labels, each of `stride` x `stride` pixels; unknown where the image's mask is false in their middle."""
    if mask is None:
        return labels
    rows, columns = (
        np.minimum(np.arange(size) * stride + stride // 2, most - 1)
        for size, most in zip(labels.shape, mask.shape, strict=True)
    )
    return np.where(mask.numpy()[np.ix_(rows, columns)], labels, UNKNOWN).astype(np.uint8)


def check_classes(models: Sequence[TrainedModel], scenes: ChosenScenes) -> None:
    """Raise UserError if a model has other classes than the scenes."""
    names = scenes.spec.classes.names
    for model in models:
        own = model.trained.facts.classes.names
        if own != names:
            raise UserError(
                f"'{model.name}' was trained with {len(own)} classes ({', '.join(own)}), the {scenes.source} have "
                f"{len(names)} ({', '.join(names)}): show them one after the other"
            )


def scores_of(grid: Grid, spec: SourceSpec) -> "Scores":
    """Return empty scores of predictions on a grid."""
    from omniocc.scores import Scores  # needs torchmetrics, whose import takes a second

    return Scores(grid, spec)


def scene_scores(grid: Grid, scene: SceneReader) -> "Scores":
    """Return empty scores of predictions on a grid for the frames of a recorded scene."""
    return scores_of(grid, spec_of(scene))


def frame_figures(scores: "Scores", labels: Tensor, truth: Batch | Truth) -> Mapping[str, float]:
    """Return the scores of one frame alone."""
    scores.reset()
    scores.update(labels[None], truth)
    found = scores.compute()
    return {key.removeprefix("voxel/"): float(found[key]) for key in FIGURES if key in found}
