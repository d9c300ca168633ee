"""Voxel labels of a geometry, voted once from the recorded points and kept beside the scenes."""

import functools
import math
import shutil
import warnings
from collections.abc import Sequence
from contextlib import closing
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import zstandard
from jaxtyping import Bool, Float32, Int32, Int64, UInt8
from torch import Tensor

from omniocc.camera import Rig
from omniocc.classes import NUM_CLASSES, UNKNOWN
from omniocc.data.labels.counts import Frames, all_frames, count_classes, kept_counts
from omniocc.data.source import Ignore, LidarScan, SceneFrames
from omniocc.data.store.codec import STEPS_PER_M, decompress
from omniocc.data.store.folder import SceneFolder
from omniocc.data.store.shard import SceneWriter, digest
from omniocc.errors import DataError, UserError
from omniocc.geometry import Grid
from omniocc.parallel import Report, make_scenes
from omniocc.progress import Progress

VOTE_VERSION = 1
"""Raise it when the same points would give other voxels."""

Reach = tuple[float, float, float]
"""Distances from the ego origin along x, y and z, m."""
MEMBER = "voxels.zst"
VOTED: tuple[Ignore, ...] = ("none", "unobserved")
"""Values of `ignore` that are possible where points vote."""
OBSERVED_VERSION = 2
"""Raise it when the same recording would give another mask."""

PIXEL_STEP = 4
"""Rays are cast for every fourth row and column of a camera: about one per 0.5 m at the rim of the paper's grid."""

_PIXELS = (slice(PIXEL_STEP // 2, None, PIXEL_STEP),) * 2
_CHUNK_RAYS = 8192


def vote(
    scene: SceneFrames, frame: int, geometry: Grid, ignore: Ignore = "none", num_classes: int = NUM_CLASSES
) -> UInt8[Tensor, "X Y Z"]:
    """Return the label of every cell of one frame, voted by its points.

    Raises:
        DataError: when the frame is damaged or has no points.
    """
    points = scene.points(frame)
    if points is None:
        raise DataError(
            f"scene '{scene.name}', frame {frame}: no points are recorded, so no voxels can be voted: "
            "the scene serves predict.py, not training"
        )
    cells = geometry.voxelize(torch.from_numpy(points.points_m), torch.from_numpy(points.labels), num_classes)
    if ignore == "unobserved":
        cells[observed(scene, frame, geometry) == 0] = UNKNOWN
    return cells


@lru_cache(maxsize=4)
def cells_beyond(geometry: Grid, reach_m: Reach) -> Bool[Tensor, "X Y Z"] | None:
    """Return the cells whose centre is farther from the ego origin along x, y or z; None if there are none."""
    beyond = (geometry.centers().abs() > torch.tensor(reach_m)).any(-1)
    return beyond if beyond.any() else None


class VoxelCache:
    """Voxels of many scenes in one geometry, as scene folders of their own with one member per frame.

    Args:
        folder: of the dataset, in which the cache is the subfolder `voxels-<hash of grid and labelling>`.
        geometry: grid whose cells the points vote in.
        ignore: which cells without points are unknown: `none` or those `unobserved`.
        fingerprint: of the data; the counts of classes are kept under it.
        num_classes: number of classes, free included.
        workers: processes that vote; 0 votes in this one.
        masks: fingerprints of masks that the cameras have besides the recorded ones, which limit what they observe.
        reach_m: distances from the ego origin along x, y and z at which the recorded points end; cells whose centre is
            farther off are unknown. None: nowhere.

    Raises:
        UserError: if `ignore` is no way of labelling.
    """

    def __init__(
        self,
        folder: Path,
        geometry: Grid,
        ignore: Ignore = "none",
        fingerprint: str = "",
        num_classes: int = NUM_CLASSES,
        workers: int = 0,
        masks: Sequence[str] = (),
        reach_m: Reach | None = None,
    ):
        if ignore not in VOTED:
            raise UserError(f"data.ignore={ignore}: choose {' or '.join(VOTED)}")
        self.beyond = None if reach_m is None else cells_beyond(geometry, reach_m)
        labelling = [] if ignore == "none" else [ignore, OBSERVED_VERSION, *masks]
        labelling += [] if self.beyond is None else [list(reach_m or ())]
        self.folder = Path(folder) / f"voxels-{digest([repr(geometry), VOTE_VERSION, *labelling])[:12]}"
        self.geometry = geometry
        self.ignore: Ignore = ignore
        self.fingerprint = fingerprint
        self.num_classes = num_classes
        self.workers = workers
        self._cached: dict[str, SceneFolder] = {}

    def prepare(self, scenes: Sequence[SceneFrames]) -> None:
        """Vote for the scenes whose cache is missing or cannot be opened.

        Raises:
            DataError: when recorded points are damaged or the disk refuses.
        """
        missing = [scene for scene in scenes if not self._opens(scene)]
        if not missing:
            return
        work = partial(self._vote_scene, {scene.name: scene for scene in missing})
        with Progress(f"voxels {self.folder.name}", sum(map(len, missing))) as progress:
            make_scenes(work, [self.folder / scene.name for scene in missing], self.workers, progress)

    def read(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"]:
        """Return the labels of one frame, voted now if they are not kept; where the cache is damaged, warn as well."""
        if not (self.folder / scene.name).exists():
            return self._vote(scene, frame)
        try:
            cached = self._cached.setdefault(scene.name, SceneFolder(self.folder / scene.name))
            blob = cached.read(frame, [MEMBER])[MEMBER]
            cells = np.frombuffer(bytearray(decompress(blob, math.prod(self.geometry.shape))), dtype=np.uint8)
            return torch.from_numpy(cells).reshape(self.geometry.shape)
        except (DataError, ValueError, RuntimeError, zstandard.ZstdError) as error:
            warnings.warn(f"voxels are voted anew: {error}", stacklevel=2)
            return self._vote(scene, frame)

    def benchmark(self, scene: SceneFrames, frame: int) -> None:
        """Return None: scores are computed on these voxels."""

    def counts(self, scenes: Sequence[SceneFrames]) -> Int64[Tensor, "C X Y Z"]:
        """Return the number of frames in which each cell has each class, unknown excluded; kept on disk."""
        path = self.folder / f"counts-{digest([self.fingerprint, [scene.name for scene in scenes]])[:12]}.zst"
        shape = (self.num_classes, *self.geometry.shape)
        return kept_counts(path, shape, lambda: self._count(all_frames(scenes)))

    def _count(self, frames: Frames) -> Int64[Tensor, "C X Y Z"]:
        with Progress("frequencies of the classes", len(frames)) as progress:
            return count_classes(self, frames, self.num_classes, self.geometry.shape, progress)

    def _opens(self, scene: SceneFrames) -> bool:
        folder = self.folder / scene.name
        cached = SceneFolder(folder)
        if not folder.exists():
            return False
        try:
            return len(cached.index.shard) == len(scene)
        except DataError as error:
            warnings.warn(f"voxels are voted anew: {error}", stacklevel=2)
            shutil.rmtree(folder)
            return False

    def _vote(self, scene: SceneFrames, frame: int) -> UInt8[Tensor, "X Y Z"]:
        cells = vote(scene, frame, self.geometry, self.ignore, self.num_classes)
        return cells if self.beyond is None else cells.masked_fill(self.beyond, UNKNOWN)

    def _vote_scene(self, scenes: dict[str, SceneFrames], folder: Path, report: Report) -> None:
        scene = scenes[folder.name]
        with closing(SceneWriter(folder)) as writer:
            if writer.finished:
                report(len(scene))
                return
            for frame in range(len(scene)):
                cells = self._vote(scene, frame).contiguous().numpy()
                writer.append({MEMBER: zstandard.ZstdCompressor(level=3).compress(cells.tobytes())}, {})
                report(1)
            writer.finish({"geometry": repr(self.geometry), "vote": VOTE_VERSION, "unknown": self.ignore})


class RayPaths(NamedTuple):
    """Fixed rays and the cells they cross.

    Attributes:
        cells: flat indices of cells, padded by the number of cells.
        exit_m: distance at which each cell is left.
    """

    cells: Int32[Tensor, "R L"]
    exit_m: Float32[Tensor, "R L"]

    def crossings(self, range_m: Float32[Tensor, " R"], num_cells: int) -> Int64[Tensor, " cells"]:
        """Return how many rays leave each cell before their range, m; with nan a ray crosses none, with inf all."""
        counts = torch.zeros(num_cells + 1, dtype=torch.int64)
        free_m = (range_m - 1 / STEPS_PER_M).nan_to_num(nan=0.0, posinf=float("inf"))
        for cells, exit_m, limit_m in zip(*(part.split(_CHUNK_RAYS) for part in (*self, free_m)), strict=True):
            counts += cells[exit_m <= limit_m.unsqueeze(1)].bincount(minlength=num_cells + 1)
        return counts[:num_cells]


def cell_evidence(scene: SceneFrames, frame: int, geometry: Grid) -> Int64[Tensor, "3 X Y Z"]:
    """Return what was measured of every cell of one frame: labelled points in it, LiDAR rays and camera rays across it.

    A ray crosses a cell if it leaves it before it hits anything. Camera rays are those of every `PIXEL_STEP`-th row and
    column whose range is known. Rays of the virtual LiDARs beside the car do not count, since the points of these
    LiDARs are recorded, but not their positions.
    """
    scan, points, num_cells = scene.lidar(frame), scene.points(frame), geometry.num_cells
    counts = torch.zeros(3, num_cells, dtype=torch.int64)
    if points is not None:
        cells, inside = geometry.flat_index(torch.from_numpy(points.points_m))
        counts[0] = cells[inside].bincount(minlength=num_cells)
    if scan is not None:
        counts[1] = _lidar_paths(geometry, scan).crossings(torch.from_numpy(scan.range_m), num_cells)
    for camera, pixels_m in enumerate(scene.camera_range_m(frame) or ()):
        paths, valid = _camera_paths(geometry, scene.rigs[frame], camera)
        range_m = torch.from_numpy(pixels_m[_PIXELS].ravel()).where(valid, torch.nan)
        counts[2] += paths.crossings(range_m, num_cells)
    return counts.reshape(3, *geometry.shape)


def observed(scene: SceneFrames, frame: int, geometry: Grid) -> UInt8[Tensor, "X Y Z"]:
    """Return 1 for the cells of one frame that hold a labelled point or are crossed by a ray, 0 for the others."""
    return (cell_evidence(scene, frame, geometry) > 0).any(0).to(torch.uint8)


@functools.lru_cache(maxsize=16)
def _camera_paths(geometry: Grid, rig: Rig, camera: int) -> tuple[RayPaths, Bool[Tensor, " R"]]:
    """Return the cells along the rays of some pixels, and the pixels that lens and mask allow."""
    rays, valid = rig.rays(camera)
    rays = torch.where(valid.unsqueeze(-1), rays, rays.new_tensor([0.0, 0.0, 1.0]))[_PIXELS].reshape(-1, 3)
    pose = torch.as_tensor(rig.ego_from_camera)[camera]
    return ray_paths(geometry, pose[:3, 3].to(rays).expand_as(rays), rays), valid[_PIXELS].flatten()


_last_lidar: dict[tuple[Grid, bytes], RayPaths] = {}


def _lidar_paths(geometry: Grid, scan: LidarScan) -> RayPaths:
    """Return the cells along the LiDAR's rays; those of the last scan are kept, since many LiDARs repeat them."""
    directions = torch.from_numpy(scan.directions)
    origins = torch.zeros_like(directions) if scan.origins is None else torch.from_numpy(scan.origins)
    key = geometry, directions.numpy().tobytes() + origins.numpy().tobytes()
    if key not in _last_lidar:
        _last_lidar.clear()
        _last_lidar[key] = ray_paths(geometry, origins, directions)
    return _last_lidar[key]


def ray_paths(geometry: Grid, origins: Float32[Tensor, "R 3"], directions: Float32[Tensor, "R 3"]) -> RayPaths:
    """Return the cells along rays from origins, m; directions may have any length above 0."""
    paths = geometry.paths(origins, directions)
    return RayPaths(torch.where(paths.cells < 0, geometry.num_cells, paths.cells), paths.exit_m.contiguous())
