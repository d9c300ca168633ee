"""A 3D view of labelled voxels, from behind and above the car."""

from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.draw.canvas import Labels
from omniocc.geometry import Grid
from rayiou.surface import extract_surface, face_corners

SKY_TOP, SKY_BOTTOM = (214, 226, 240), (252, 252, 252)
LIGHT = np.array([-0.35, 0.45, 0.82])
SUPERSAMPLE = 2
NEAR_M = 0.2
EDGE_DARKENING = 0.22
# Body and cabin of the ego car: x, y and z from ... to in the ego frame, and colour.
CAR_BOXES = (
    (((-2.3, 2.3), (-0.95, 0.95), (-1.95, -1.2)), (250, 250, 252)),
    (((-1.7, 0.9), (-0.8, 0.8), (-1.2, -0.65)), (70, 80, 95)),
)

CAR_SIZE = f"the car is {CAR_BOXES[0][0][0][1] - CAR_BOXES[0][0][0][0]:g} m long"
"""The scale of the image in words."""


class Faces(NamedTuple):
    """Quadrilaterals, which are drawn in the order of falling depth.

    Drawing farther cells first is exact for a grid: along a ray, each next cell is beyond a boundary that separates
    its centre from the previous one's. (Only where a ray grazes a ring of a cylinder may two cells swap.)

    Attributes:
        corners: (F, 4, 3) metres, ego frame.
        normals: (F, 3) outward unit vectors.
        colors: (F, 3) RGB.
        depth_m: (F,) distance of the cell from the eye.
    """

    corners: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    depth_m: np.ndarray


def render_voxels(
    labels: Labels,
    geometry: Grid,
    classes: ClassTable,
    width: int,
    height: int,
    eye_m: tuple[float, float, float] = (-28.0, 0.0, 22.0),
    target_m: tuple[float, float, float] = (0.5, 0.0, -3.0),
    view_deg: float = 60.0,
) -> np.ndarray:
    """Return an image of the occupied cells in their class colours, with the ego car as a white box.

    Unknown cells are not drawn. The image has `width` x `height` px; `eye_m` is the viewpoint and `target_m` the point
    in the middle of the image, ego frame; `view_deg` is the horizontal field of view.
    """
    eye = np.array(eye_m)
    cells = _cell_faces(labels, geometry, classes.palette, eye)
    parts = [cells, *(_box_faces(bounds, rgb, eye) for bounds, rgb in CAR_BOXES)]
    faces = Faces(*map(np.concatenate, zip(*parts, strict=True)))
    towards = ((eye - faces.corners.mean(1)) * faces.normals).sum(1) > 0
    faces = Faces(*(part[towards] for part in faces))
    size = (width * SUPERSAMPLE, height * SUPERSAMPLE)
    pixels, in_front = _project(faces.corners, eye, np.array(target_m), view_deg, size)
    low, high = pixels.min(1), pixels.max(1)
    seen = in_front & (high > 0).all(1) & (low < size).all(1)
    order = np.flatnonzero(seen)[np.argsort(-faces.depth_m[seen], kind="stable")]
    colors = _shade(faces)
    canvas = _background(*size)
    spans = np.minimum(high - low, 24 * SUPERSAMPLE).min(1)
    edges = colors * (1 - EDGE_DARKENING * np.clip(spans / (8 * SUPERSAMPLE), 0, 1))[:, None]
    quads = np.round(pixels * 16).astype(np.int32)
    for k in order:
        cv2.fillConvexPoly(canvas, quads[k], colors[k].tolist(), cv2.LINE_8, 4)
        cv2.polylines(canvas, [quads[k]], True, edges[k].tolist(), 1, cv2.LINE_AA, shift=4)
    return cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)


def _cell_faces(labels: Tensor, geometry: Grid, palette: np.ndarray, eye: np.ndarray) -> Faces:
    corners, cells = extract_surface((labels != FREE) & (labels != UNKNOWN), geometry)
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    centers = geometry.centers(torch.float64).reshape(-1, 3).numpy()[cells]
    colors = palette[labels.reshape(-1).numpy()[cells]].astype(np.float64)
    return Faces(corners, normals, colors, np.linalg.norm(centers - eye, axis=1))


def _box_faces(bounds_m: tuple[tuple[float, float], ...], rgb: tuple[int, int, int], eye: np.ndarray) -> Faces:
    """Return the faces of a box of the ego car, drawn as if 4 m nearer, since they are larger than those of cells."""
    bounds = np.array(bounds_m)
    corners, normals = [], []
    for axis in range(3):
        for side in (0, 1):
            corners.append(np.take_along_axis(bounds, face_corners(axis, side).T, 1).T)
            normals.append((2 * side - 1) * np.eye(3)[axis])
    colors = np.tile(np.array(rgb, dtype=np.float64), (6, 1))
    depth_m = np.full(6, np.linalg.norm(bounds.mean(1) - eye) - 4.0)
    return Faces(np.array(corners), np.array(normals), colors, depth_m)


def _project(
    points: np.ndarray, eye: np.ndarray, target: np.ndarray, view_deg: float, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (F, 4, 2) of the corners (F, 4, 3), and whether all four are in front of the eye (F,)."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    relative = points - eye
    z = relative @ forward
    focal = size[0] / 2 / np.tan(np.radians(view_deg) / 2)
    safe = np.maximum(z, NEAR_M)[..., None]
    slopes = np.stack([relative @ right, relative @ down], -1) / safe
    return slopes * focal + (np.array(size) - 1) / 2, np.all(z > NEAR_M, axis=1)


def _shade(faces: Faces) -> np.ndarray:
    """Return colours under a fixed sun, a little lighter higher up and paler far away."""
    diffuse = np.clip(faces.normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
    height = np.clip((faces.corners[..., 2].mean(1) + 2.4) / 6, 0, 1)
    lit = faces.colors * (0.62 + 0.42 * diffuse + 0.14 * height)[:, None] + 26 * height[:, None]
    haze = np.clip((faces.depth_m - 30) / 60, 0, 0.3)[:, None]
    return np.clip(lit * (1 - haze) + haze * np.array(SKY_BOTTOM), 0, 255)


def _background(width: int, height: int) -> np.ndarray:
    mix = np.linspace(0, 1, height)[:, None, None]
    column = (1 - mix) * np.array(SKY_TOP) + mix * np.array(SKY_BOTTOM)
    return np.ascontiguousarray(np.broadcast_to(column, (height, width, 3)).astype(np.uint8))
