"""What is drawn in space: voxels as triangles, the outlines of cameras, and the rays of RayIoU."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64, UInt8
from torch import Tensor

from omniocc.camera import Rig
from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.draw.bev import HALLUCINATED, MISSED, WRONG
from omniocc.draw.voxels import LIGHT
from omniocc.geometry import Cuboid, Cylinder, Grid
from omniocc.metric import ray_hits
from rayiou.surface import surface, with_area

Rgb = tuple[int, int, int]
DIFFERENCES: dict[str, Rgb] = {"missed": MISSED, "hallucinated": HALLUCINATED, "wrong class": WRONG}
"""Kinds of differences, in the words and colours of the sheets."""
AMBIENT, DIFFUSE = 0.62, 0.42
"""Brightness of a face in the shade, and what the light adds to one that looks at it."""
LENGTH_M = 0.6
"""Distance of the drawn border of an image from its camera."""
STEPS = 12
"""Points along each edge of an image."""
WITHIN_M = 2.0
"""Difference of range below which a ray of the right class counts as a hit: the middle threshold of RayIoU."""


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


def camera_outline(rig: Rig, camera: int) -> list[np.ndarray]:
    """Return lines (P, 3), m, ego frame: the border of a camera's image, and from the camera to its corners.

    They are right for any lens, also one that sees more than 180 degrees.

    The border is where the rays of the outermost pixels are `LENGTH_M` from the camera. Where the lens does not reach
    the edge of the image, its pixels nearest to that edge, towards the middle of the image, are taken.
    """
    model, ego_from_camera = rig.cameras[camera], rig.ego_from_camera[camera].double()
    edge = _edge(model.width, model.height)
    middle = torch.tensor([(model.width - 1) / 2, (model.height - 1) / 2], dtype=torch.float64)
    fractions = torch.linspace(1, 0, 65, dtype=torch.float64)[:, None, None]
    rays, valid = model.unproject(middle + fractions * (edge - middle))
    outermost = valid.to(torch.uint8).argmax(0)  # the first of the largest: argmax takes no bool
    chosen = rays[outermost, torch.arange(len(edge))]
    start = ego_from_camera[:3, 3]
    border = (start + LENGTH_M * chosen @ ego_from_camera[:3, :3].T).numpy()
    corners = [np.stack([start.numpy(), border[k * STEPS]]) for k in range(4)]
    return [np.concatenate([border, border[:1]]), *corners]


def _edge(width: int, height: int) -> torch.Tensor:
    """Return pixels around an image, (4 * STEPS, 2): right along the top, down, left, up."""
    steps = torch.arange(STEPS, dtype=torch.float64) / STEPS
    zeros, ones = torch.zeros(STEPS, dtype=torch.float64), torch.ones(STEPS, dtype=torch.float64)
    u = torch.cat([steps, ones, 1 - steps, zeros]) * (width - 1)
    v = torch.cat([zeros, steps, ones, 1 - steps]) * (height - 1)
    return torch.stack([u, v], dim=1)


class RayOutcomes(NamedTuple):
    """The rays that RayIoU counts, from the ego origin, by whether the prediction has their first hit.

    Attributes:
        hits_m: (H, 3) true ends of the rays with the right class within `WITHIN_M`, m, ego frame.
        misses_m: (M, 2, 3) true and predicted ends of the others; where nothing is hit, a ray ends with the grid.
    """

    hits_m: np.ndarray
    misses_m: np.ndarray


def ray_outcomes(
    truth: UInt8[Tensor, "X Y Z"],
    prediction: UInt8[Tensor, "X Y Z"],
    grid: Cylinder | Cuboid,
    classes: ClassTable,
    directions: Float64[Tensor, "R 3"],
) -> RayOutcomes:
    """Return the outcome of every ray whose true first hit is of a known class; see `omniocc.metric.RayIoU`."""
    true, found = (
        ray_hits(labels, grid, directions=directions, num_classes=classes.num_classes) for labels in (truth, prediction)
    )
    true_m, found_m = true.exit_m.double(), found.exit_m.double()
    counted = (true.labels != FREE) & (true.labels != UNKNOWN) & true_m.isfinite()
    hit = (true.labels == found.labels) & ((true_m - found_m).abs() < WITHIN_M)
    true_ends, found_ends = ((range_m[:, None] * directions).numpy() for range_m in (true_m, found_m))
    hits, misses = (counted & hit).numpy(), (counted & ~hit).numpy()
    return RayOutcomes(true_ends[hits], np.stack([true_ends, found_ends], 1)[misses])
