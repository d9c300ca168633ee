"""Media of a test frame for W&B besides its sheet: images that can be enlarged, voxels that can be rotated."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.draw.bev import bev, error_bev, error_legend
from omniocc.draw.canvas import blank, class_legend, legend
from omniocc.draw.paint import paint_voxels
from omniocc.draw.ranges import ERROR_LEGEND, RANGE_LEGEND, error_bar, error_colors, range_bar, range_colors
from omniocc.draw.sheet import azimuths, below, panorama_row
from omniocc.geometry import Grid

CAMERA_PX, BEV_PX, PANORAMA_PX = 400, 400, 960
CAR_CENTER_M, CAR_SIZE_M = (0.0, 0.0, -1.45), (4.6, 1.9, 1.5)
"""Box of the ego car, ego frame; it stands on the virtual world's road at z = -2.2 m."""


class MediaItem(NamedTuple):
    """An image (H, W, 3) uint8 RGB, or points (P, 6) of x, y, z in metres and RGB, and its caption."""

    content: np.ndarray
    caption: str


def class_cloud(labels: UInt8[Tensor, "X Y Z"], geometry: Grid, classes: ClassTable) -> Float[np.ndarray, "P 6"]:
    """Return the centre (ego frame, m, rounded to the centimetre) and class colour (RGB) of every occupied cell."""
    occupied = (labels != FREE) & (labels != UNKNOWN)
    centers_m = geometry.centers()[occupied].double().numpy().round(2)
    return np.concatenate([centers_m, classes.palette[labels[occupied].numpy()].astype(np.float64)], axis=1)


def voxel_media(
    images: UInt8[np.ndarray, "N H W 3"],
    rig: Rig,
    truth: UInt8[Tensor, "X Y Z"],
    prediction: UInt8[Tensor, "X Y Z"],
    geometry: Grid,
    classes: ClassTable,
) -> dict[str, list[MediaItem]]:
    """Return the media of an occupancy prediction, by key.

    They are the images with the predicted classes painted on, bird's-eye views of truth, prediction and their
    differences, each above its legend, and points of the occupied cells of both.
    """
    painted = paint_voxels(list(images), rig, prediction, geometry, classes, CAMERA_PX)
    names, kinds = class_legend(classes, BEV_PX), error_legend(BEV_PX)
    views = {
        "truth": below([bev(truth, geometry, classes, BEV_PX), names], BEV_PX),
        "prediction": below([bev(prediction, geometry, classes, BEV_PX), names], BEV_PX),
        "differences": below([error_bev(truth, prediction, geometry, BEV_PX), kinds], BEV_PX),
    }
    return {
        "cameras": [MediaItem(image, name) for image, name in zip(painted, rig.names, strict=True)],
        "bev": of_one_height(views),
        "points_truth": [MediaItem(class_cloud(truth, geometry, classes), "truth")],
        "points_prediction": [MediaItem(class_cloud(prediction, geometry, classes), "prediction")],
    }


def range_media(
    predicted_m: Float[Tensor, "h w"], true_m: Float[Tensor, "h w"], panorama: Equirectangular
) -> dict[str, list[MediaItem]]:
    """Return panoramas of true ranges, of predicted ranges (nan: not valid) and of their difference, as `erp`."""
    assert true_m.shape == (panorama.height, panorama.width)
    predicted, true = predicted_m.numpy(), true_m.numpy()
    width = PANORAMA_PX
    metres = [azimuths(width), range_bar(width), legend(RANGE_LEGEND, width)]
    difference = [azimuths(width), error_bar(width), legend(ERROR_LEGEND, width)]
    rows = {
        "true range": (range_colors(true), metres),
        "predicted range": (range_colors(predicted), metres),
        "predicted minus true": (error_colors(predicted, true), difference),
    }
    shown = {name: below([panorama_row(colors, name, width), *scale], width) for name, (colors, scale) in rows.items()}
    return {"erp": of_one_height(shown)}


def of_one_height(images: Mapping[str, UInt8[np.ndarray, "H W 3"]]) -> list[MediaItem]:
    """Return named images as items, with paper below the lower ones: W&B shows images of one size alone as a list."""
    height = max(map(len, images.values()))
    shown = {name: blank(image.shape[1], height) for name, image in images.items()}
    for name, image in images.items():
        shown[name][: len(image)] = image
    return [MediaItem(image, name) for name, image in shown.items()]


def wandb_object(item: MediaItem) -> Any:
    """Return the W&B object of an item; points get a box for the ego car."""
    import wandb

    if item.content.ndim == 3:
        return wandb.Image(item.content, caption=item.caption, file_type="jpg")
    car = wandb.box3d(
        center=CAR_CENTER_M, size=CAR_SIZE_M, orientation=(1, 0, 0, 0), color=(255, 255, 255), label="own car"
    )
    cloud = {"type": "lidar/beta", "points": item.content, "boxes": np.array([car]), "vectors": np.array([])}
    return wandb.Object3D(cloud, caption=item.caption)
