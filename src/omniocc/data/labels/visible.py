"""Two masks of the cells that cameras see, as OccTrack360 has them for the fisheyes of KITTI-360.

Lin et al., OccTrack360 (arXiv 2603.08521): a mask of the field of view of the lens, the same in every frame, and one by
rays that end at the first occupied cell. The masks differ: most cells in the field of view are hidden. Here lenses are
the full models with their distortion, cameras are where the calibration puts them, and rays visit every cell they
cross.
"""

from typing import Literal, no_type_check

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from omniocc.camera import Rig
from omniocc.geometry import Cuboid
from rayiou.compiled import compiled

MaskKind = Literal["field_of_view", "ray_traced"]
MASKS: tuple[MaskKind, ...] = ("field_of_view", "ray_traced")


def field_of_view_mask(grid: Cuboid, rig: Rig) -> Bool[Tensor, "X Y Z"]:
    """Return the cells whose middle falls on a usable pixel of some camera, hidden by other cells or not."""
    centers, in_view = grid.centers(torch.float64), torch.zeros(grid.shape, dtype=torch.bool)
    for camera in range(len(rig.cameras)):
        for x, slab in enumerate(centers):  # a slab at a time, to save memory
            in_view[x] |= rig.project_into(camera, slab)[1]
    return in_view


def ray_traced_mask(grid: Cuboid, labels: UInt8[Tensor, "X Y Z"], rig: Rig) -> Bool[Tensor, "X Y Z"]:
    """Return the cells on rays from the cameras up to the first cell that is not free (0), this one included.

    Every camera casts a ray to the middle of every cell at the grid's surface that is in front of it (z > 0), even
    outside of its field of view.

    Raises:
        ValueError: if the labels are not of the grid's shape, or a camera is outside of the grid.
    """
    if tuple(labels.shape) != grid.shape:
        raise ValueError(f"labels must have the shape of their grid, {grid.shape}, got {tuple(labels.shape)}")
    low, size = np.array(grid.bounds)[:, 0], np.array(grid.cell_m)
    targets, seen = surface_cells(grid.shape), np.zeros(grid.shape, dtype=bool)
    for name, pose in zip(rig.names, rig.ego_from_camera.numpy(), strict=True):
        start = (pose[:3, 3] - low) / size
        if ((start < 0) | (start >= grid.shape)).any():
            raise ValueError(f"camera '{name}' is outside of the volume, {grid}: choose a larger one")
        ahead = ((targets + 0.5 - start) * size) @ pose[:3, 2] > 0
        mark_seen(labels.numpy(), start, targets[ahead], seen)
    return torch.from_numpy(seen)


def surface_cells(shape: tuple[int, int, int]) -> np.ndarray:
    """Return the indices (S, 3) int64 of the cells at the surface of a grid of this shape."""
    inner = np.zeros(shape, dtype=bool)
    inner[1:-1, 1:-1, 1:-1] = True
    return np.argwhere(~inner)


@compiled
@no_type_check
def mark_seen(labels, start, targets, seen):
    """Set the cells in `seen` that rays from `start` to the middles of `targets` cross up to the first not free one.

    Coordinates are in cells: cell i reaches from i to i + 1. A ray through an edge or corner of a cell crosses the face
    of the lowest axis first. The algorithm is that of Amanatides and Woo (1987).
    """
    cell, step = np.empty(3, np.int64), np.empty(3, np.int64)
    # for each axis, from 0 at the start to 1 at the target: where the ray meets the next face, and from face to face
    next_face, face_step = np.empty(3), np.empty(3)
    for ray in range(len(targets)):
        for axis in range(3):
            offset = targets[ray, axis] + 0.5 - start[axis]
            cell[axis] = int(np.floor(start[axis]))
            step[axis] = 1 if offset > 0 else -1
            face_step[axis] = 1 / abs(offset) if offset != 0 else np.inf
            to_face = cell[axis] + (offset > 0) - start[axis]
            next_face[axis] = to_face / offset if offset != 0 else np.inf
        while True:
            seen[cell[0], cell[1], cell[2]] = True
            if labels[cell[0], cell[1], cell[2]] != 0:
                break
            axis = 0
            for other in range(1, 3):
                if next_face[other] < next_face[axis]:
                    axis = other
            if next_face[axis] >= 1:  # the ray ends in this cell
                break
            cell[axis] += step[axis]
            next_face[axis] += face_step[axis]
