"""One sheet per frame of predicted occupancy, beside the ground truth where it is available."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import ClassTable
from omniocc.draw.bev import bev, error_legend
from omniocc.draw.canvas import Images, Labels, Ranges, class_legend, legend
from omniocc.draw.compare import views_and_maps
from omniocc.draw.paint import paint_voxels, voxel_panorama
from omniocc.draw.ranges import NOT_PREDICTED, range_bar, range_colors
from omniocc.draw.sheet import camera_rows, column_width, inner_width, panorama_row, row, stack
from omniocc.draw.voxels import render_voxels
from omniocc.geometry import Grid

ALL_AROUND = Equirectangular(360, 90, 45.0, -45.0)
"""Directions of the panorama of voxels for models without a panorama of range."""

SIDE_DEG = 105.0
"""Largest azimuth, to either side, of cameras in the first row."""


class RangePanorama(NamedTuple):
    """A panorama of ranges around the ego origin.

    Attributes:
        panorama: directions of its pixels.
        range_m: ranges, nan where no range is predicted.
    """

    panorama: Equirectangular
    range_m: Ranges


def occupancy_sheet(
    images: Images,
    rig: Rig,
    prediction: Labels,
    geometry: Grid,
    classes: ClassTable,
    ranges: RangePanorama | None = None,
    truth: Labels | None = None,
    caption: str = "",
    width_px: int = 1280,
) -> np.ndarray:
    """Return the sheet: voxels on the images, as a panorama, from behind and from above.

    `ranges` are None if the model predicts none, `truth` if none is available; `caption` is the line at the top.
    """
    inner = inner_width(width_px)
    order, columns = camera_order(rig), columns_of(len(images))
    painted = paint_voxels(images, rig, prediction, geometry, classes, column_width(inner, columns))
    named = {"predicted voxels": prediction} if truth is None else {"true voxels": truth, "predicted": prediction}
    rows = [
        *camera_rows([painted[k] for k in order], inner, columns, [rig.names[k] for k in order]),
        *_panoramas(named, geometry, classes, ranges, inner),
        *_overviews(named, geometry, classes, inner),
        class_legend(classes, inner),
    ]
    if truth is not None:
        rows.append(error_legend(inner))
    return stack(rows, width_px, caption)


def camera_order(rig: Rig) -> list[int]:
    """Return the cameras from left to right: first those facing forward or sideways, then those facing back."""
    ahead = rig.ego_from_camera[:, :3, 2]
    azimuth_deg = torch.rad2deg(torch.atan2(ahead[:, 1], ahead[:, 0])).round(decimals=6).tolist()
    front = [k for k, azimuth in enumerate(azimuth_deg) if abs(azimuth) <= SIDE_DEG]
    back = [k for k, azimuth in enumerate(azimuth_deg) if abs(azimuth) > SIDE_DEG]
    return sorted(front, key=lambda k: -azimuth_deg[k]) + sorted(back, key=lambda k: azimuth_deg[k] % 360)


def columns_of(cameras: int) -> int:
    """Return the number of images in a row."""
    return cameras if cameras < 3 else 4 if cameras % 4 == 0 else 3


def _panoramas(
    named: dict[str, Tensor], geometry: Grid, classes: ClassTable, ranges: RangePanorama | None, width: int
) -> list[np.ndarray]:
    directions = ALL_AROUND if ranges is None else ranges.panorama
    rows = [
        panorama_row(voxel_panorama(labels, geometry, classes, directions, width), f"{name}, all around", width)
        for name, labels in named.items()
    ]
    if ranges is None:
        return rows
    predicted = panorama_row(range_colors(ranges.range_m.numpy()), "predicted range", width)
    return [*rows, predicted, range_bar(width), legend([("not predicted", NOT_PREDICTED)], width)]


def _overviews(named: dict[str, Tensor], geometry: Grid, classes: ClassTable, width: int) -> list[np.ndarray]:
    if len(named) == 1:
        ((name, labels),) = named.items()
        half = column_width(width, 2)
        views = [render_voxels(labels, geometry, classes, half, half), bev(labels, geometry, classes, half)]
        return [row(views, (name, "from above"), width)]
    truth, prediction = named.values()
    views, maps = views_and_maps(truth, prediction, geometry, classes, width)
    above = row(maps, ("truth from above", "prediction from above", "differences"), width)
    return [row(views, tuple(named), width), above]
