"""The cells that the recorded sensors saw: a cell that no ray has crossed is unknown, not free.

A cell is observed if it holds a labelled point, or if some ray of the ego LiDAR or of a camera leaves it before the ray
hits anything. No cell counts as free unless a ray has crossed it, and any grid will do, since only recorded ranges are
needed. Cells that only rays of the virtual LiDARs beside the car cross remain unobserved, since the points of these
LiDARs are recorded, but not their positions.
"""

import functools
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float32, Int32, UInt8
from torch import Tensor

from omniocc.camera import Rig
from omniocc.data.source import LidarScan, SceneFrames
from omniocc.data.store.codec import STEPS_PER_M
from omniocc.geometry import Grid

OBSERVED_VERSION = 2
"""Raise it when the same recording would give another mask."""

PIXEL_STEP = 4
"""Rays are cast for every fourth row and column of a camera: about one per 0.5 m at the rim of the paper's grid."""

_PIXELS = (slice(PIXEL_STEP // 2, None, PIXEL_STEP),) * 2
_CHUNK_RAYS = 8192


class RayPaths(NamedTuple):
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
    scan, points, num_cells = scene.lidar(frame), scene.points(frame), geometry.num_cells
    mask = torch.zeros(num_cells, dtype=torch.bool)
    if scan is not None:
        mask |= _lidar_paths(geometry, scan).crossed(torch.from_numpy(scan.range_m), num_cells)
    for camera, pixels_m in enumerate(scene.camera_range_m(frame) or ()):
        paths, valid = _camera_paths(geometry, scene.rigs[frame], camera)
        mask |= paths.crossed(torch.from_numpy(pixels_m[_PIXELS].ravel()).where(valid, torch.nan), num_cells)
    if points is not None:
        cells, inside = geometry.flat_index(torch.from_numpy(points.points_m))
        mask[cells[inside]] = True
    return mask.to(torch.uint8).reshape(geometry.shape)


@functools.lru_cache(maxsize=16)
def _camera_paths(geometry: Grid, rig: Rig, camera: int) -> tuple[RayPaths, Bool[Tensor, " R"]]:
    """Return the cells along the rays of some pixels, and the pixels that lens and mask allow."""
    rays, valid = rig.rays(camera)
    rays = torch.where(valid.unsqueeze(-1), rays, rays.new_tensor([0.0, 0.0, 1.0]))[_PIXELS].reshape(-1, 3)
    pose = torch.as_tensor(rig.ego_from_camera)[camera]
    return _ray_paths(geometry, pose[:3, 3].to(rays).expand_as(rays), rays), valid[_PIXELS].flatten()


_last_lidar: dict[tuple[Grid, bytes], RayPaths] = {}


def _lidar_paths(geometry: Grid, scan: LidarScan) -> RayPaths:
    """Return the cells along the LiDAR's rays; those of the last scan are kept, since many LiDARs repeat them."""
    directions = torch.from_numpy(scan.directions)
    origins = torch.zeros_like(directions) if scan.origins is None else torch.from_numpy(scan.origins)
    key = geometry, directions.numpy().tobytes() + origins.numpy().tobytes()
    if key not in _last_lidar:
        _last_lidar.clear()
        _last_lidar[key] = _ray_paths(geometry, origins, directions)
    return _last_lidar[key]


def _ray_paths(geometry: Grid, origins: Float32[Tensor, "R 3"], directions: Float32[Tensor, "R 3"]) -> RayPaths:
    paths = geometry.paths(origins, directions)
    return RayPaths(torch.where(paths.cells < 0, geometry.num_cells, paths.cells), paths.exit_m.contiguous())
