"""Sparse ranges and classes of pixels from the points of a LiDAR."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import UNKNOWN


class Projected(NamedTuple):
    """What the points show in one image.

    Attributes:
        range_m: range of the nearest point of every pixel, from the camera, m; nan without a point.
        labels: its class; 255 without a point.
    """

    range_m: Float32[np.ndarray, "height width"]
    labels: UInt8[np.ndarray, "height width"]


def onto_cameras(points_m: np.ndarray, labels: np.ndarray | None, rig: Rig) -> list[Projected]:
    """Return what points (P, 3), m, ego frame, with classes (P,) show in every camera of a rig.

    Nearer points hide farther ones in the same pixel only: LiDAR and cameras stand apart, so some pixels of near
    things show what is behind them.
    """
    points = torch.as_tensor(points_m, dtype=torch.float64)
    found = []
    for index, camera in enumerate(rig.cameras):
        pixels, valid = rig.project_into(index, points)
        range_m = (points - rig.ego_from_camera[index, :3, 3]).norm(dim=1)
        found.append(nearest(pixels[valid], range_m[valid], _of(labels, valid), (camera.height, camera.width)))
    return found


def onto_panorama(points_m: np.ndarray, labels: np.ndarray | None, panorama: Equirectangular) -> Projected:
    """Return what points (P, 3), m, ego frame, show in the panorama around the ego origin."""
    points = torch.as_tensor(points_m, dtype=torch.float64)
    pixels, valid = panorama.project(points)
    range_m = points.norm(dim=1)
    return nearest(pixels[valid], range_m[valid], _of(labels, valid), (panorama.height, panorama.width))


def nearest(
    pixels: Float[Tensor, "P 2"], range_m: Float[Tensor, " P"], labels: UInt8[Tensor, " P"], size: tuple[int, int]
) -> Projected:
    """Return the nearest of the points in every pixel of an image of (height, width) px."""
    height, width = size
    columns, rows = pixels.round().long().unbind(-1)
    place = rows.clamp(0, height - 1) * width + columns.clamp(0, width - 1)
    order = range_m.argsort(descending=True, stable=True).numpy()  # of equal pixels numpy keeps the last: the nearest
    ranges = np.full(height * width, np.nan, np.float32)
    classes = np.full(height * width, UNKNOWN, np.uint8)
    ranges[place.numpy()[order]] = range_m.numpy()[order]
    classes[place.numpy()[order]] = labels.numpy()[order]
    return Projected(ranges.reshape(size), classes.reshape(size))


def _of(labels: np.ndarray | None, valid: Tensor) -> UInt8[Tensor, " P"]:
    if labels is None:
        return torch.full((int(valid.sum()),), UNKNOWN, dtype=torch.uint8)
    return torch.as_tensor(labels)[valid]
