"""The cells that the recorded sensors saw: a cell that no ray has crossed is unknown, not free.

A cell is observed if it holds a labelled point, or if some ray of the ego LiDAR or of a camera leaves it before the ray
hits anything. No cell counts as free unless a ray has crossed it, and any grid will do, since only recorded ranges are
needed. Cells that only the virtual LiDARs beside the car see through remain unobserved: the points of these LiDARs are
recorded, their positions are not.
"""

import functools
from collections.abc import Iterator
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float32, Int32, UInt8
from torch import Tensor

from omniocc.camera import Rig
from omniocc.data.source import LidarScan, SceneFrames
from omniocc.data.store.codec import STEPS_PER_M
from omniocc.geometry import Grid

OBSERVED_VERSION = 1
"""Raise it when the same recording would give another mask."""

PIXEL_STEP = 4
"""Rays are cast for every fourth row and column of a camera: about one per 0.5 m at the rim of the paper's grid."""

_EVERY_STEP = slice(PIXEL_STEP // 2, None, PIXEL_STEP)
_PIXELS = (_EVERY_STEP, _EVERY_STEP)
_CHUNK_RAYS = 8192


class Sight(NamedTuple):
    """Fixed rays and the cells they cross.

    Attributes:
        cells: flat indices of cells, padded by the number of cells.
        exit_m: distance at which each cell is left.
    """

    cells: Int32[Tensor, "R L"]
    exit_m: Float32[Tensor, "R L"]

    def crossed(self, range_m: Float32[Tensor, " R"], num_cells: int) -> Bool[Tensor, " cells"]:
        """Return the cells that some ray leaves before its range, m; with nan a ray crosses none, with inf all."""
        seen = torch.zeros(num_cells + 1, dtype=torch.bool)
        free_m = (range_m - 1 / STEPS_PER_M).nan_to_num(nan=0.0, posinf=float("inf"))
        for cells, exit_m, limit_m in zip(*(part.split(_CHUNK_RAYS) for part in (*self, free_m)), strict=True):
            seen[cells[exit_m <= limit_m.unsqueeze(1)].long()] = True
        return seen[:num_cells]


def observed(scene: SceneFrames, frame: int, geometry: Grid) -> UInt8[Tensor, "X Y Z"]:
    """Return 1 for every cell of one frame that was observed, 0 for the others."""
    rig, scan, points = scene.rigs[frame], scene.lidar(frame), scene.points(frame)
    mask = torch.zeros(geometry.num_cells, dtype=torch.bool)
    for range_m, sight in _rays(scene, frame, scan, rig, geometry):
        mask |= sight.crossed(range_m, geometry.num_cells)
    if points is not None:
        cells, inside = geometry.flat_index(torch.from_numpy(points.points_m))
        mask[cells[inside]] = True
    return mask.to(torch.uint8).reshape(geometry.shape)


def _rays(
    scene: SceneFrames, frame: int, scan: LidarScan | None, rig: Rig, geometry: Grid
) -> Iterator[tuple[Float32[Tensor, " R"], Sight]]:
    """Yield recorded ranges, with their rays, of the LiDAR and of every camera."""
    if scan is not None:
        yield torch.from_numpy(scan.range_m), _lidar_sight(geometry, scan)
    ranges_m = scene.camera_range_m(frame)
    for camera, range_m in enumerate(ranges_m or ()):
        yield torch.from_numpy(range_m[_PIXELS].ravel()), _camera_sight(geometry, rig, camera)


@functools.lru_cache(maxsize=16)
def _camera_sight(geometry: Grid, rig: Rig, camera: int) -> Sight:
    rays, valid = rig.rays(camera)
    rays = torch.where(valid.unsqueeze(-1), rays, rays.new_tensor([0.0, 0.0, 1.0]))[_PIXELS].reshape(-1, 3)
    pose = torch.as_tensor(rig.ego_from_camera)[camera]
    return _sight(geometry, pose[:3, 3].to(rays).expand_as(rays), rays)


_lidar_sights: dict[tuple[Grid, bytes], Sight] = {}


def _lidar_sight(geometry: Grid, scan: LidarScan) -> Sight:
    """Return the cells along the LiDAR's rays; those of the last scan are kept, since many LiDARs repeat them."""
    directions = torch.from_numpy(scan.directions)
    origins = torch.zeros_like(directions) if scan.origins is None else torch.from_numpy(scan.origins)
    key = geometry, directions.numpy().tobytes() + origins.numpy().tobytes()
    if key not in _lidar_sights:
        _lidar_sights.clear()
        _lidar_sights[key] = _sight(geometry, origins, directions)
    return _lidar_sights[key]


def _sight(geometry: Grid, origins: Float32[Tensor, "R 3"], directions: Float32[Tensor, "R 3"]) -> Sight:
    paths = geometry.paths(origins, directions)
    return Sight(torch.where(paths.cells < 0, geometry.num_cells, paths.cells), paths.exit_m.contiguous())
