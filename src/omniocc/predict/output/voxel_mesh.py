"""The surface of labelled voxels, for programs that show meshes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from omniocc.classes import FREE, UNKNOWN, ClassTable
from omniocc.geometry import Grid
from rayiou.surface import surface, with_area


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


def voxel_mesh(labels: UInt8[Tensor, "X Y Z"], geometry: Grid, classes: ClassTable) -> VoxelMesh:
    """Return the faces of occupied cells towards cells that are not; unknown cells count as empty."""
    quads, cells = with_area(surface((labels != FREE) & (labels != UNKNOWN), geometry))
    colors = classes.palette[labels.reshape(-1).numpy()[cells]]
    first = 4 * np.arange(len(quads))[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return VoxelMesh(quads.reshape(-1, 3), np.repeat(colors, 4, axis=0), triangles)
