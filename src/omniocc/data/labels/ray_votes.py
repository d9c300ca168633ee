"""Voxel labels voted by the measured rays of a frame and its neighbours, kept beside the scenes."""

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from omniocc.classes import FREE, NUM_CLASSES, UNKNOWN
from omniocc.data.labels.voxels import VoxelCache, ray_paths
from omniocc.data.rays import rays_around
from omniocc.data.source import SceneFrames
from omniocc.errors import DataError
from omniocc.geometry import Grid
from omniocc.loss import Rays, RayWindow

RAY_VERSION = 1
"""Raise it when the same scans would give other labels."""
OCCUPIED = 1
"""Class of all occupied cells where classes are not used."""


class RayVotes(VoxelCache):
    """Voxels of measured rays: what most hits in a cell are; free where rays only pass; unknown (255) elsewhere.

    Without classes occupied cells have the class 1.

    Args:
        folder: as in `VoxelCache`, as all others but `window`.
        window: which rays vote.
    """

    def __init__(
        self,
        folder: Path,
        geometry: Grid,
        window: RayWindow,
        fingerprint: str,
        num_classes: int = NUM_CLASSES,
        workers: int = 0,
    ):
        labelling = f"rays {RAY_VERSION} {sorted(window.frames)} {window.classes}"  # part of the folder's name
        super().__init__(folder, geometry, "unobserved", fingerprint, num_classes, workers, [labelling])
        self.window = window

    def class_counts(self, scenes: Sequence[SceneFrames]) -> Int64[Tensor, "C X Y Z"]:
        """Return `counts`; without classes every occupied class is as frequent as any other.

        Raises:
            DataError: if no hit has a class, but classes are to be used.
        """
        counts = self.counts(scenes)
        if self.window.classes:
            if not counts[FREE + 1 :].any():
                raise DataError("no ray of the training frames hits a known class: loss.rays.classes=false uses none")
            return counts
        classes = self.num_classes - 1
        return torch.cat([classes * counts[:1], counts[OCCUPIED].expand(classes, -1, -1, -1)])

    def _vote(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"]:
        rays = rays_around(scene, frame, self.window)
        if rays is None:
            return torch.full(self.geometry.shape, UNKNOWN, dtype=torch.uint8)
        return vote_rays(self.geometry, rays, self.window.classes, self.num_classes)


def vote_rays(grid: Grid, rays: Rays, classes: bool, num_classes: int) -> UInt8[Tensor, "X Y Z"]:
    """Return the class of every cell by the rays of one sample, (1, R) without padding; 255 where no ray was."""
    origins_m, ends_m, labels = (part[0] for part in rays)
    hit, ways_m = labels != FREE, ends_m - origins_m
    voters = labels[hit] if classes else torch.full_like(labels[hit], OCCUPIED)
    cells = grid.voxelize(ends_m[hit], voters, num_classes)
    limit_m = ways_m.norm(dim=-1).where(hit, torch.inf)
    crossed = ray_paths(grid, origins_m, ways_m).crossings(limit_m, grid.num_cells).reshape(grid.shape) > 0
    return torch.where((cells == FREE) & ~crossed, UNKNOWN, cells)
