"""Predict one frame from arrays of images."""

import sys
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Float32, UInt8
from torch import nn

from omniocc.camera import Equirectangular, Rig
from omniocc.data.formats.files import check_aspect
from omniocc.errors import DataError, UserError
from omniocc.geometry import Grid
from omniocc.model import OccupancyModel
from omniocc.predict.input.images import resized_to_width
from omniocc.predict.options import choose_device
from omniocc.predict.output.voxel_files import raise_grid
from omniocc.predict.predictor import STEPS, Images, Input, Predictor, predict_depth
from omniocc.predict.road import WITHIN, on_road
from omniocc.predict.stopwatch import Stopwatch
from omniocc.predict.training_data import TrainingData


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


def predict_voxels(model: OccupancyModel, trained: TrainingData, images: Images, rig: Rig) -> PredictedVoxels:
    """Return the voxels of one frame without a past, as `predict.py occupancy` computes them.

    A line on stderr says if the grid moves because the road lies at another height than in the training.

    Raises:
        UserError: when the rig cannot be scaled, or the network returns NaN.
    """
    placed, height_m, line = trained.place(rig)
    if line:
        print(f"road      {line}", file=sys.stderr, flush=True)
    predictor = Predictor(model, trained.width_for(rig), (), choose_device(None))
    labels = predictor.step(Input(*predictor.scaled(images, placed)), Stopwatch(predictor.device, STEPS)).labels
    classes = trained.classes
    colors = classes.palette[: classes.num_classes]
    return PredictedVoxels(labels.numpy(), raise_grid(model.geometry, height_m), classes.names, colors)


def predict_ranges(model: nn.Module, trained: TrainingData, images: Images, rig: Rig) -> PredictedRanges:
    """Return the ranges of one frame, as `predict.py depth` computes them.

    Raises:
        UserError: when the rig cannot be scaled, the network needs more than images, or returns NaN.
    """
    batch, scaled = resized_to_width(images, rig, trained.width_for(rig))
    depth = on_road(predict_depth(model, batch, scaled, choose_device(None)), model, scaled, WITHIN)
    return PredictedRanges(depth.known_range_m()[0].numpy(), cast(Equirectangular, model.panorama))


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
