"""Voxels as triangles: a mesh for each class, and for each kind of difference between truth and prediction."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8
from torch import Tensor

from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.draw.bev import HALLUCINATED, MISSED, WRONG
from omniocc.draw.voxels import LIGHT
from omniocc.geometry import Grid
from rayiou.surface import surface, with_area

Rgb = tuple[int, int, int]
DIFFERENCES: dict[str, Rgb] = {"missed": MISSED, "hallucinated": HALLUCINATED, "wrong class": WRONG}
"""Kinds of differences, in the words and colours of the sheets."""
AMBIENT, DIFFUSE = 0.62, 0.42
"""Brightness of a face in the shade, and what the light adds to one that looks at it."""


class Mesh(NamedTuple):
    """Triangles in one colour, shaded by a fixed light; faces that look the same way share vertices.

    Attributes:
        points_m: (V, 3) float32, ego frame.
        colors: (V, 3) uint8 RGB.
        triangles: (T, 3) uint32 indices of vertices, counter-clockwise seen from outside.
    """

    points_m: np.ndarray
    colors: np.ndarray
    triangles: np.ndarray


def class_meshes(labels: UInt8[Tensor, "X Y Z"], grid: Grid, classes: ClassTable) -> dict[str, Mesh]:
    """Return a mesh for each class that occurs: the faces of its cells towards cells that are free or unknown.

    Faces between two occupied cells are left out, also between cells of two classes.
    """
    found = with_area(surface((labels != FREE) & (labels != UNKNOWN), grid))
    owners = labels.reshape(-1).numpy()[found.cells]
    return {
        row.name: shaded(found.corners_m[owners == row.id], row.rgb)
        for row in classes.rows
        if row.id != FREE and (owners == row.id).any()
    }


def difference_meshes(truth: UInt8[Tensor, "X Y Z"], prediction: UInt8[Tensor, "X Y Z"], grid: Grid) -> dict[str, Mesh]:
    """Return a mesh for each kind of difference that occurs (`DIFFERENCES`); cells of unknown truth do not count."""
    cells = difference_cells(truth, prediction)
    return {kind: region_mesh(cells[kind], grid, rgb) for kind, rgb in DIFFERENCES.items() if cells[kind].any()}


def difference_cells(
    truth: UInt8[Tensor, "X Y Z"], prediction: UInt8[Tensor, "X Y Z"]
) -> dict[str, Bool[Tensor, "X Y Z"]]:
    """Return the cells of each kind of difference."""
    known, true, predicted = truth != UNKNOWN, truth != FREE, prediction != FREE
    return {
        "missed": known & true & ~predicted,
        "hallucinated": known & ~true & predicted,
        "wrong class": known & true & predicted & (truth != prediction),
    }


def region_mesh(cells: Bool[Tensor, "X Y Z"], grid: Grid, rgb: Rgb) -> Mesh:
    """Return the surface of a set of cells in one colour."""
    return shaded(with_area(surface(cells, grid)).corners_m, rgb)


def shaded(quads: np.ndarray, rgb: Rgb) -> Mesh:
    """Return quadrilaterals (F, 4, 3), counter-clockwise seen from outside, as triangles of a shaded colour."""
    normals = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
    brightness = np.rint((AMBIENT + DIFFUSE * light) * 255).astype(np.float32)
    corners = np.concatenate([quads.astype(np.float32), np.repeat(brightness[:, None, None], 4, 1)], -1)
    rows = np.ascontiguousarray(corners.reshape(-1, 4)) + np.float32(0)  # -0 and 0 are the same place
    _, first, places = np.unique(rows.view("V16").reshape(-1), return_index=True, return_inverse=True)
    indices = places.reshape(-1, 4).astype(np.uint32)
    colors = np.minimum(rows[first, 3:] / 255 * np.array(rgb, np.float32), 255)
    return Mesh(rows[first, :3], colors.astype(np.uint8), indices[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
