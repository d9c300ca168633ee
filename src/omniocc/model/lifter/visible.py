"""Which camera sees which voxel, and where."""

from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor

from omniocc.camera import Rig, normalize_pixels
from omniocc.geometry import Grid


class Pairs(NamedTuple):
    """Every (query, camera) of which the camera sees the query's voxel, sorted by query.

    Attributes:
        query: index of the query.
        camera: index of the camera.
        points: where the camera sees it, in `grid_sample` coordinates.
        counts: cameras that see each query.
        first: index of each query's first pair.
    """

    query: Int64[Tensor, " P"]
    camera: Int64[Tensor, " P"]
    points: Float[Tensor, "P 2"]
    counts: Int64[Tensor, " Q"]
    first: Int64[Tensor, " Q"]


@lru_cache(maxsize=16)
def reference_points(
    rig: Rig, geometry: Grid, device: torch.device
) -> tuple[Float32[Tensor, "N cells 2"], Bool[Tensor, "N cells"]]:
    """Projects all cell centres into all cameras: `grid_sample` coordinates, and whether they are visible there.

    Depends on rig and grid alone, so each rig is projected once. The result is shared: never write to it.
    """
    centers_m = geometry.centers(torch.float64).reshape(-1, 3)
    pixels, valid = rig.project(centers_m)
    points = [
        normalize_pixels(pixels_px, camera.width, camera.height)
        for pixels_px, camera in zip(pixels, rig.cameras, strict=True)
    ]
    points = torch.where(valid[..., None], torch.stack(points), 0.0)
    return points.to(device=device, dtype=torch.float32), valid.to(device)


def visible_pairs(
    points: Float32[Tensor, "N cells 2"], valid: Bool[Tensor, "N cells"], cells: Int64[Tensor, " Q"]
) -> Pairs:
    """The pairs of the queries at `cells` (row-major indices)."""
    seen = valid.T[cells]
    query, camera = seen.nonzero(as_tuple=True)
    counts = seen.sum(1)
    return Pairs(query, camera, points[camera, cells[query]], counts, counts.cumsum(0) - counts)
