"""Faces of occupied cells, from which images and meshes of voxels are drawn."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from rayiou.grid import Grid

FACE_CYCLE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
"""Coordinates of the four corners of a face along the two axes in its plane, counter-clockwise."""
FLAT_M2 = 1e-9
"""Largest area of a face that counts as flat, without area."""


class Surface(NamedTuple):
    """Faces of occupied cells.

    Attributes:
        corners_m: (F, 4, 3) float64, ego frame, counter-clockwise seen from outside.
        cells: (F,) row-major index of the occupied cell that each face belongs to.
    """

    corners_m: np.ndarray
    cells: np.ndarray


def extract_surface(occupied: Bool[Tensor, "X Y Z"], grid: Grid) -> Surface:
    """Return the faces of occupied cells whose neighbour is not occupied or is outside the grid.

    Faces are ordered by axis, then lower before upper, then row-major by cell. The curved faces of a cylinder are
    replaced by flat ones through the same corners; faces at its axis have no area.
    """
    solid = occupied.reshape(-1).numpy()
    neighbors = grid.neighbors().reshape(-1, 6).numpy()
    edges = torch.meshgrid(*(grid.edges(axis) for axis in range(3)), indexing="ij")
    lattice = grid.from_axes(*edges).numpy()
    corners, cells = [], []
    for side in range(6):
        beyond = neighbors[:, side]  # -1 where there is no neighbour
        exposed = np.flatnonzero(solid & ~((beyond >= 0) & solid[beyond]))
        index = np.stack(np.unravel_index(exposed, grid.shape), 1)[:, None] + face_corners(side // 2, side % 2)
        corners.append(lattice[tuple(np.moveaxis(index, -1, 0))])
        cells.append(exposed)
    return Surface(np.concatenate(corners), np.concatenate(cells))


def drop_flat_faces(faces: Surface) -> Surface:
    """Return the faces that have an area; those at the axis of a cylinder have none."""
    quads = faces.corners_m
    diagonals = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
    kept = np.linalg.norm(diagonals, axis=-1) > 2 * FLAT_M2  # the diagonals' cross product is twice the area
    return Surface(quads[kept], faces.cells[kept])


def face_corners(axis: int, upper: int) -> np.ndarray:
    """Return the corners (4, 3) of a unit cell's lower (0) or upper (1) face, counter-clockwise seen from outside.

    The order of corners relies on right-handed axes, which every grid has: (x, y, z), or (r, theta, z) in a cylinder.
    """
    corners = np.zeros((4, 3), dtype=np.int64)
    corners[:, axis] = upper
    corners[:, [(axis + 1) % 3, (axis + 2) % 3]] = FACE_CYCLE if upper else FACE_CYCLE[::-1]
    return corners
