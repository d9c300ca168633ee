"""The surface of labelled voxels, for programs that show meshes."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from omniocc.classes import FREE, PALETTE, UNKNOWN
from omniocc.geometry import Grid

AROUND = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
"""Corners of a face along the two axes that lie in it, in turn."""

FLAT_M2 = 1e-9
"""Faces with less area are left out: at the axis of a cylinder they have none."""


class VoxelMesh(NamedTuple):
    """Four vertices and two triangles per face, so that every face has one colour.

    Attributes:
        points_m: (V, 3) float64, ego frame.
        colors: (V, 3) uint8 RGB, of the class.
        triangles: (T, 3) indices of vertices, counter-clockwise seen from outside.
    """

    points_m: np.ndarray
    colors: np.ndarray
    triangles: np.ndarray


def voxel_mesh(labels: UInt8[Tensor, "X Y Z"], geometry: Grid) -> VoxelMesh:
    """Faces of occupied cells towards cells that are not; unknown cells count as empty.

    Faces of a cylinder's cells along the angle are drawn flat, as chords.
    """
    cells = labels.reshape(-1).numpy()
    occupied = (cells != FREE) & (cells != UNKNOWN)
    neighbors = geometry.neighbors().reshape(-1, 6).numpy()
    lattice = _lattice(geometry)
    quads, classes = [], []
    for side in range(6):
        beyond = neighbors[:, side]
        open_cells = np.flatnonzero(occupied & ~((beyond >= 0) & occupied[beyond]))
        quads.append(_faces(np.stack(np.unravel_index(open_cells, geometry.shape), 1), side // 2, side % 2, lattice))
        classes.append(cells[open_cells])
    return _triangulated(np.concatenate(quads), PALETTE[np.concatenate(classes)])


def _lattice(geometry: Grid) -> np.ndarray:
    edges = torch.meshgrid(*(geometry.edges(axis) for axis in range(3)), indexing="ij")
    return geometry.from_axes(*edges).numpy()


def _faces(cells: np.ndarray, axis: int, up: int, lattice: np.ndarray) -> np.ndarray:
    """(F, 4, 3) corners of the lower or upper face of cells along an axis, counter-clockwise from outside."""
    offsets = np.zeros((4, 3), dtype=np.int64)
    offsets[:, axis] = up
    # axes in cyclic order are right-handed, in a cylinder (r, theta, z) too
    offsets[:, [(axis + 1) % 3, (axis + 2) % 3]] = AROUND if up else AROUND[::-1]
    index = cells[:, None] + offsets
    return lattice[tuple(np.moveaxis(index, -1, 0))]


def _triangulated(quads: np.ndarray, colors: np.ndarray) -> VoxelMesh:
    diagonals = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
    solid = np.linalg.norm(diagonals, axis=-1) > 2 * FLAT_M2
    quads, colors = quads[solid], colors[solid]
    first = 4 * np.arange(len(quads))[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return VoxelMesh(quads.reshape(-1, 3), np.repeat(colors, 4, axis=0), triangles)
