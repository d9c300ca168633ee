"""Shapes that the viewer draws in space: meshes of voxels, outlines of cameras, and rays of RayIoU."""

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
from rayiou import ray_hits
from rayiou.surface import drop_flat_faces, extract_surface

Rgb = tuple[int, int, int]
DIFFERENCES: dict[str, Rgb] = {"missed": MISSED, "hallucinated": HALLUCINATED, "wrong class": WRONG}
"""Kinds of differences and their colours, which the image sheets share."""
AMBIENT, DIFFUSE = 0.62, 0.42
"""Brightness of a face turned away from the light, and what is added to one that faces it; full colour is 1."""
OUTLINE_M = 0.6
"""Distance from a camera to the drawn border of its image."""
EDGE_POINTS = 12
"""Points drawn along each edge of an image."""
HIT_ERROR_M = 2.0
"""Error of range below which a ray of the right class counts as a hit: the middle threshold of RayIoU."""


class Mesh(NamedTuple):
    """Triangles in one colour, shaded by a fixed light; equally bright faces share vertices.

    Attributes:
        points_m: (V, 3) float32, ego frame.
        colors: (V, 3) uint8 RGB.
        triangles: (T, 3) uint32 indices of vertices, counter-clockwise seen from outside.
    """

    points_m: np.ndarray
    colors: np.ndarray
    triangles: np.ndarray


def class_meshes(labels: UInt8[Tensor, "X Y Z"], grid: Grid, classes: ClassTable) -> dict[str, Mesh]:
    """Return a mesh for each class that occurs: the faces between its cells and free or unknown ones.

    A face between two occupied cells is left out, even if their classes differ.
    """
    faces = drop_flat_faces(extract_surface((labels != FREE) & (labels != UNKNOWN), grid))
    owners = labels.reshape(-1).numpy()[faces.cells]
    return {
        row.name: shade_faces(faces.corners_m[owners == row.id], row.rgb)
        for row in classes.rows
        if row.id != FREE and (owners == row.id).any()
    }


def difference_meshes(truth: UInt8[Tensor, "X Y Z"], prediction: UInt8[Tensor, "X Y Z"], grid: Grid) -> dict[str, Mesh]:
    """Return a mesh for each kind of difference that occurs (`DIFFERENCES`); cells of unknown truth have none."""
    cells = difference_cells(truth, prediction)
    return {kind: region_mesh(cells[kind], grid, rgb) for kind, rgb in DIFFERENCES.items() if cells[kind].any()}


def difference_cells(
    truth: UInt8[Tensor, "X Y Z"], prediction: UInt8[Tensor, "X Y Z"]
) -> dict[str, Bool[Tensor, "X Y Z"]]:
    """Return the cells of each kind of difference."""
    known, occupied, predicted = truth != UNKNOWN, truth != FREE, prediction != FREE
    return {
        "missed": known & occupied & ~predicted,
        "hallucinated": known & ~occupied & predicted,
        "wrong class": known & occupied & predicted & (truth != prediction),
    }


def region_mesh(cells: Bool[Tensor, "X Y Z"], grid: Grid, rgb: Rgb) -> Mesh:
    """Return the surface of a set of cells in one colour."""
    return shade_faces(drop_flat_faces(extract_surface(cells, grid)).corners_m, rgb)


def shade_faces(quads: np.ndarray, rgb: Rgb) -> Mesh:
    """Return faces (F, 4, 3), counter-clockwise seen from outside, as triangles; one colour is shaded by a light."""
    normals = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
    brightness = np.rint((AMBIENT + DIFFUSE * light) * 255).astype(np.float32)
    corners = np.concatenate([quads.astype(np.float32), np.repeat(brightness[:, None, None], 4, 1)], -1)
    rows = np.ascontiguousarray(corners.reshape(-1, 4)) + np.float32(0)  # -0 and 0 are the same place
    # a row of x, y, z and brightness is compared as one value of 16 bytes
    _, first, vertices = np.unique(rows.view("V16").reshape(-1), return_index=True, return_inverse=True)
    indices = vertices.reshape(-1, 4).astype(np.uint32)
    colors = np.minimum(rows[first, 3:] / 255 * np.array(rgb, np.float32), 255)
    return Mesh(rows[first, :3], colors.astype(np.uint8), indices[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))


def camera_outline(rig: Rig, camera: int) -> list[np.ndarray]:
    """Return lines (P, 3), m, ego frame: the border of a camera's image, then four from the camera to its corners.

    The border joins the ends of rays of `OUTLINE_M` through pixels of the image's edge, so a lens may see more than 180
    degrees. Where the lens does not reach the edge, the next pixel towards the middle of the image that it does reach
    is taken.
    """
    model, ego_from_camera = rig.cameras[camera], rig.ego_from_camera[camera].double()
    edge = _edge(model.width, model.height)
    middle = torch.tensor([(model.width - 1) / 2, (model.height - 1) / 2], dtype=torch.float64)
    fractions = torch.linspace(1, 0, 65, dtype=torch.float64)[:, None, None]
    rays, valid = model.unproject(middle + fractions * (edge - middle))
    outermost = valid.to(torch.uint8).argmax(0)  # the first valid one, nearest to the edge; argmax takes no bool
    chosen = rays[outermost, torch.arange(len(edge))]
    start = ego_from_camera[:3, 3]
    border = (start + OUTLINE_M * chosen @ ego_from_camera[:3, :3].T).numpy()
    corners = [np.stack([start.numpy(), border[k * EDGE_POINTS]]) for k in range(4)]
    return [np.concatenate([border, border[:1]]), *corners]


def _edge(width: int, height: int) -> torch.Tensor:
    """Return the pixels (4 * EDGE_POINTS, 2) around an image: along the top to the right, down, left, then up."""
    steps = torch.arange(EDGE_POINTS, dtype=torch.float64) / EDGE_POINTS
    zeros, ones = torch.zeros(EDGE_POINTS, dtype=torch.float64), torch.ones(EDGE_POINTS, dtype=torch.float64)
    u = torch.cat([steps, ones, 1 - steps, zeros]) * (width - 1)
    v = torch.cat([zeros, steps, ones, 1 - steps]) * (height - 1)
    return torch.stack([u, v], dim=1)


class RayOutcomes(NamedTuple):
    """The rays from the ego origin that RayIoU counts, split into hits and misses of the prediction.

    Attributes:
        hits_m: (H, 3) true ends of the rays of the right class whose error is below `HIT_ERROR_M`, m, ego frame.
        misses_m: (M, 2, 3) true and predicted ends of the others; a ray that hits nothing ends where the grid ends.
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
    """Return the hits and misses among rays whose true first hit has a known class; see `omniocc.metric.RayIoU`."""
    truth_hits, predicted_hits = (
        ray_hits(labels, grid, directions=directions, num_classes=classes.num_classes) for labels in (truth, prediction)
    )
    true_m, predicted_m = truth_hits.exit_m.double(), predicted_hits.exit_m.double()
    counted = (truth_hits.labels != FREE) & (truth_hits.labels != UNKNOWN) & true_m.isfinite()
    hit = (truth_hits.labels == predicted_hits.labels) & ((true_m - predicted_m).abs() < HIT_ERROR_M)
    true_ends, predicted_ends = ((range_m[:, None] * directions).numpy() for range_m in (true_m, predicted_m))
    hits, misses = (counted & hit).numpy(), (counted & ~hit).numpy()
    return RayOutcomes(true_ends[hits], np.stack([true_ends, predicted_ends], 1)[misses])
