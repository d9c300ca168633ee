"""Labels and counts of voxels that follow from the measured rays of frames and their neighbours."""

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from omniocc.classes import FREE, NUM_CLASSES, OCCUPANCY_CLASSES, UNKNOWN
from omniocc.data.labels.counts import all_frames
from omniocc.data.labels.voxels import VoxelCache, ray_paths
from omniocc.data.rays import rays_around
from omniocc.data.source import SceneFrames
from omniocc.data.spacing import evenly_spaced
from omniocc.errors import DataError
from omniocc.geometry import Grid
from omniocc.loss import Rays, RayWindow
from omniocc.loss.lidar_rays import occupied_cells, ray_queries
from omniocc.progress import Progress

RAY_VERSION = 2
"""Raise it when the same scans would give other labels or counts."""
NO_CLASSES = "no ray of the training frames hits a known class: loss=lidar_rays loss.rays.classes=false uses none"
QUERIES = 8
"""Places before the end of a ray that are counted."""
COUNTED = 1000
"""Training frames at most whose rays are counted, evenly spaced."""


class RayVotes(VoxelCache):
    """Voxels of measured rays: what most hits in a cell are; free where rays only pass; unknown (255) elsewhere.

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
        # part of the folder's name; the folders of some sources hold frames of other options as well
        labelling = f"rays {RAY_VERSION} {sorted(window.frames)} {fingerprint}"
        super().__init__(folder, geometry, "unobserved", fingerprint, num_classes, workers, [labelling])
        self.window = window

    def counts(self, scenes: Sequence[SceneFrames]) -> Int64[Tensor, "C X Y Z"]:
        """Return what `VoxelCache.counts` does; raise DataError if no cell is occupied, so that nothing is to learn."""
        found = super().counts(scenes)
        if not found[FREE + 1 :].any():
            raise DataError(NO_CLASSES)
        return found

    def _vote(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"]:
        rays = rays_around(scene, frame, self.window)
        if rays is None:
            return torch.full(self.geometry.shape, UNKNOWN, dtype=torch.uint8)
        return vote_rays(self.geometry, rays, self.num_classes)


def vote_rays(grid: Grid, rays: Rays, num_classes: int) -> UInt8[Tensor, "X Y Z"]:
    """Return the class of every cell by the rays of one sample, (1, R) without padding.

    It is 255 where no ray was, and where all hits are of unknown class. With two classes these are occupied.
    """
    if num_classes == OCCUPANCY_CLASSES.num_classes:
        rays = rays._replace(labels=rays.labels.where(rays.labels != UNKNOWN, FREE + 1))
    _, ends_m, labels = (part[0] for part in rays)
    hit = labels != FREE
    cells = grid.voxelize(ends_m[hit], labels[hit], num_classes)
    return torch.where((cells == FREE) & (crossings(grid, rays) == 0), UNKNOWN, cells)


def crossings(grid: Grid, rays: Rays) -> Int64[Tensor, "X Y Z"]:
    """Return how many rays of one sample, (1, R) without padding, leave each cell before they end."""
    origins_m, ends_m, labels = (part[0] for part in rays)
    ways_m = ends_m - origins_m
    limit_m = ways_m.norm(dim=-1).where(labels != FREE, torch.inf)
    return ray_paths(grid, origins_m, ways_m).crossings(limit_m, grid.num_cells).reshape(grid.shape)


def rays_seen(grid: Grid, rays: Rays) -> Int64[Tensor, "X Y Z"]:
    """Return how many rays of one sample, (1, R) without padding, cross each cell or end in it."""
    cells, inside = grid.flat_index(rays.ends_m[rays.labels != FREE])
    return crossings(grid, rays) + cells[inside].bincount(minlength=grid.num_cells).reshape(grid.shape)


def count_rays(
    scenes: Sequence[SceneFrames], grid: Grid, window: RayWindow, num_classes: int
) -> Int64[Tensor, "C X Y Z"]:
    """Return how often rays find each cell free, or of each class, in at most `COUNTED` frames.

    Hits and places before them have the same sum, since the loss (`omniocc.loss.LidarRays`) weighs them equally. Hits
    of unknown class count for all occupied classes alike.

    Raises:
        DataError: if there are no rays, or no hit has a class, but classes are to be used; or naming a damaged frame.
    """
    hits = torch.zeros(num_classes + 1, grid.num_cells, dtype=torch.float64)  # free, the classes, unknown
    middles, frames = (torch.arange(QUERIES) + 0.5) / QUERIES, all_frames(scenes)
    frames = [frames[number] for number in evenly_spaced(len(frames), COUNTED)]
    with Progress("frequencies of the classes on rays", len(frames)) as progress:
        for scene, frame in frames:
            rays = rays_around(scene, frame, window)
            if rays is not None:
                places = middles.expand(*rays.labels.shape, -1)
                cells, labels, counted = ray_queries(grid, rays, places, occupied_cells(grid, rays))
                row = labels[counted].long().clamp(max=num_classes)
                place = row * grid.num_cells + cells[counted]
                hits += place.bincount(minlength=hits.numel()).view_as(hits)
            progress.advance()
    free, known, unknown = hits[FREE], hits[FREE + 1 : num_classes], hits[num_classes]
    if not hits.any():
        raise DataError("the training frames have no LiDAR scan that crosses the grid; loss=paper learns from voxels")
    if window.classes and not known.any():
        raise DataError(NO_CLASSES)
    occupied = (num_classes - 1) * known + unknown
    free = (num_classes - 1) * free
    balanced = occupied * (free.sum() / occupied.sum().clamp(min=1))
    return torch.cat([free[None], balanced]).round().long().view(num_classes, *grid.shape)
