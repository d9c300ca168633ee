"""Which cells the recorded sensors saw: what no ray has crossed is unknown, not free.

A cell is observed if it holds a labelled point, or if some ray of the ego LiDAR or of a camera leaves it before the ray
hits anything. That is sound (nothing is taken for free that was not looked through) and holds for any grid, since only
recorded ranges are needed. What only the virtual LiDARs beside the car could see through stays unobserved: their points
are recorded, their places are not.
"""

import functools
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int32, UInt8
from torch import Tensor

from omniocc.camera import Rig
from omniocc.data.store.codec import STEPS_PER_M, decode_lidar, decode_points, decode_range
from omniocc.data.store.reader import SceneReader
from omniocc.geometry import Grid
from omniocc.world.sensors.lidar import ego_directions

OBSERVED_VERSION = 1
"""Raise it when the same recording would give another mask."""

PIXEL_STEP = 4
"""Every so manieth row and column of a camera; at the rim of the paper's grid that is about a ray per 0.5 m."""

_CHUNK_RAYS = 8192


class Sight(NamedTuple):
    """Fixed rays and the cells they cross.

    Attributes:
        cells: flat cell index, the number of cells where there is none.
        exit_m: distance at which each cell is left.
    """

    cells: Int32[Tensor, "R L"]
    exit_m: Float32[Tensor, "R L"]

    def crossed(self, range_m: Float32[Tensor, " R"], num_cells: int) -> Bool[Tensor, " cells"]:
        """Cells that some ray leaves before its range; nan sees nothing, inf everything."""
        seen = torch.zeros(num_cells + 1, dtype=torch.bool)
        free_m = (range_m - 1 / STEPS_PER_M).nan_to_num(nan=0.0, posinf=float("inf"))
        for cells, exit_m, limit_m in zip(*(part.split(_CHUNK_RAYS) for part in (*self, free_m)), strict=True):
            seen[cells[exit_m <= limit_m.unsqueeze(1)].long()] = True
        return seen[:num_cells]


def observed(scene: SceneReader, frame: int, geometry: Grid) -> UInt8[Tensor, "X Y Z"]:
    """1 for every cell of one frame that was observed, 0 for the others."""
    rig = scene.rig
    cameras = [f"range{k}.zst" for k in range(len(rig.cameras))]
    blobs = scene.read(frame, [*cameras, "points.zst", "lidar.zst"])
    ranges_m = [decode_range(blobs[name])[_pixels()].ravel() for name in cameras]
    range_m = torch.from_numpy(np.concatenate([decode_lidar(blobs["lidar.zst"])[0], *ranges_m]))
    mask = _sight(geometry, rig).crossed(range_m, geometry.num_cells)
    points_m, _ = decode_points(blobs["points.zst"])
    cells, inside = geometry.flat_index(torch.from_numpy(points_m))
    mask[cells[inside]] = True
    return mask.to(torch.uint8).reshape(geometry.shape)


def _pixels() -> tuple[slice, slice]:
    every = slice(PIXEL_STEP // 2, None, PIXEL_STEP)
    return every, every


@functools.lru_cache(maxsize=2)
def _sight(geometry: Grid, rig: Rig) -> Sight:
    directions = [torch.from_numpy(ego_directions())]
    origins = [torch.zeros_like(directions[0])]
    for k, pose in enumerate(torch.as_tensor(rig.ego_from_camera)):
        rays, valid = rig.rays(k)
        rays = torch.where(valid.unsqueeze(-1), rays, rays.new_tensor([0.0, 0.0, 1.0]))[_pixels()].reshape(-1, 3)
        directions.append(rays)
        origins.append(pose[:3, 3].to(rays).expand_as(rays))
    paths = geometry.paths(torch.cat(origins), torch.cat(directions))
    return Sight(torch.where(paths.cells < 0, geometry.num_cells, paths.cells), paths.exit_m.contiguous())
