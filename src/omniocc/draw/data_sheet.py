"""One sheet per frame of a dataset: do cameras, ranges and voxels agree?"""

from collections.abc import Sequence

import cv2
import numpy as np

from omniocc.camera import Rig
from omniocc.classes import ClassTable
from omniocc.draw.bev import bev
from omniocc.draw.canvas import Images, Labels, class_legend
from omniocc.draw.ranges import range_bar, range_colors
from omniocc.draw.sheet import beside, camera_rows, inner_width, panorama_row, stack
from omniocc.draw.voxel_sheet import camera_order, columns_of
from omniocc.draw.voxels import render_voxels
from omniocc.geometry import Grid

DOT_PX = 2


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
        rows += [beside(views, inner), class_legend(classes, inner)]
    return stack(rows, width_px, caption)


def with_dots(image: np.ndarray, range_m: np.ndarray | None, least_width: int = 640) -> np.ndarray:
    """Return an image, enlarged if it is small, with a dot in the colour of its range on every pixel that has one."""
    scale = max(1, -(-least_width // image.shape[1]))
    large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    if range_m is None:
        return large
    colors = range_colors(range_m)
    for row, column in np.argwhere(np.isfinite(range_m)):
        place = (round((column + 0.5) * scale - 0.5), round((row + 0.5) * scale - 0.5))
        cv2.circle(large, place, DOT_PX, colors[row, column].tolist(), -1)
    return large
