"""One sheet per frame: of predicted occupancy, beside the truth where there is one, or of the data alone."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import ClassTable
from omniocc.draw.bev import bev, error_legend
from omniocc.draw.canvas import Images, Labels, Ranges, class_legend, legend
from omniocc.draw.compare import views_and_maps
from omniocc.draw.paint import paint_voxels, voxel_panorama
from omniocc.draw.ranges import UNKNOWN_RANGE, range_bar, range_colors
from omniocc.draw.sheet import (
    azimuths,
    camera_rows,
    column_width,
    elevations,
    inner_width,
    panorama_row,
    row,
    stack,
)
from omniocc.draw.voxels import CAR_SIZE, render_voxels
from omniocc.geometry import Grid

ALL_AROUND = Equirectangular(360, 90, 45.0, -45.0)
"""Directions of the panorama of voxels for models without a panorama of range."""

SIDE_DEG = 105.0
"""Largest azimuth, to either side, of cameras in the first row."""
DOT_PX = 2


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
        panorama_row(
            voxel_panorama(labels, geometry, classes, directions, width),
            f"{name}, all around, {elevations(directions)}",
            width,
        )
        for name, labels in named.items()
    ]
    if ranges is None:
        return [*rows, azimuths(width)]
    predicted = panorama_row(range_colors(ranges.range_m.numpy()), "predicted range", width)
    return [*rows, predicted, azimuths(width), range_bar(width), legend([UNKNOWN_RANGE], width)]


def _overviews(named: dict[str, Tensor], geometry: Grid, classes: ClassTable, width: int) -> list[np.ndarray]:
    if len(named) == 1:
        ((name, labels),) = named.items()
        half = column_width(width, 2)
        views = [render_voxels(labels, geometry, classes, half, half), bev(labels, geometry, classes, half)]
        return [row(views, (f"{name} from behind; {CAR_SIZE}", "from above"), width)]
    truth, prediction = named.values()
    views, maps = views_and_maps(truth, prediction, geometry, classes, width)
    above = row(maps, ("truth from above", "prediction from above", "differences"), width)
    return [row(views, [f"{name} from behind; {CAR_SIZE}" for name in named], width), above]


def data_sheet(
    images: Images,
    rig: Rig,
    camera_range_m: Sequence[np.ndarray] | None,
    panorama_range_m: np.ndarray | None,
    labels: Labels | None,
    grid: Grid,
    classes: ClassTable,
    caption: str = "",
    width_px: int = 1280,
) -> np.ndarray:
    """Return the sheet: known ranges as dots on the images, as a panorama, and the voxels from behind and above.

    What is None is left out. A wrong calibration shows as dots beside the things that they belong to.
    """
    inner, order = inner_width(width_px), camera_order(rig)
    ranges = [None] * len(images) if camera_range_m is None else camera_range_m
    dotted = [with_dots(image, range_m) for image, range_m in zip(images, ranges, strict=True)]
    rows = camera_rows([dotted[k] for k in order], inner, columns_of(len(images)), [rig.names[k] for k in order])
    if panorama_range_m is not None:
        rows.append(panorama_row(range_colors(panorama_range_m), "known ranges", inner))
    if camera_range_m is not None or panorama_range_m is not None:
        rows.append(range_bar(inner))
    if labels is not None:
        height = inner // 3
        views = [render_voxels(labels, grid, classes, inner - height - 8, height), bev(labels, grid, classes, height)]
        names = (f"voxels from behind; {CAR_SIZE}", "from above")
        rows += [row(views, names, inner), class_legend(classes, inner)]
    return stack(rows, width_px, caption)


def with_dots(image: np.ndarray, range_m: np.ndarray | None, least_width: int = 640) -> np.ndarray:
    """Return an image, enlarged if it is small, with a dot in the colour of its range on every pixel that has one."""
    scale = max(1, -(-least_width // image.shape[1]))
    large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    if range_m is None:
        return large
    colors = range_colors(range_m)
    for y, x in np.argwhere(np.isfinite(range_m)):
        place = (round((x + 0.5) * scale - 0.5), round((y + 0.5) * scale - 0.5))
        cv2.circle(large, place, DOT_PX, colors[y, x].tolist(), -1)
    return large
