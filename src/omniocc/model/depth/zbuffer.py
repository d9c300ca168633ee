"""Ranges seen from several cameras, drawn into one panorama around the ego origin: the nearest wins."""

from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from omniocc.camera import Equirectangular, Rig


@lru_cache(maxsize=16)
def camera_rays(
    rig: Rig, size: tuple[int, int], device: torch.device
) -> tuple[Float32[Tensor, "N height width 3"], Bool[Tensor, "N height width"]]:
    """Ego-frame directions of the pixels of maps of `size` (width, height) that span the images, and which are seen."""
    resized = rig.resized(*size)
    rays, seen = zip(*(resized.rays(k) for k in range(len(rig.cameras))), strict=True)
    return torch.stack(rays).to(device), torch.stack(seen).to(device)


def draw_nearest(
    points_m: Float[Tensor, "B P 3"],
    value: Float[Tensor, "B P"],
    drawn: Bool[Tensor, "B P"],
    panorama: Equirectangular,
) -> tuple[Float[Tensor, "B h w"], Float[Tensor, "B h w"]]:
    """Distance from the origin to the nearest point in each pixel, and that point's value; inf and 0 where none is.

    Args:
        points_m: ego frame.
        value: above 0; of equally near points the greatest counts.
        drawn: points that count.
        panorama: whose pixels are filled.
    """
    pixels, inside = panorama.project(points_m)
    column, row = pixels.round().long().unbind(-1)
    # straight behind lies half a pixel beyond the first or last column
    column = column % panorama.width
    size = panorama.height * panorama.width
    cell = torch.where(inside & drawn, row.clamp(0, panorama.height - 1) * panorama.width + column, size)
    range_m = points_m.norm(dim=-1)
    nearest = range_m.new_full((len(points_m), size + 1), float("inf")).scatter_reduce(1, cell, range_m, "amin")
    won = torch.where(range_m <= nearest.gather(1, cell), value, 0.0)
    values = torch.zeros_like(nearest).scatter_reduce(1, cell, won, "amax")
    shape = (panorama.height, panorama.width)
    return nearest[:, :size].unflatten(1, shape), values[:, :size].unflatten(1, shape)


def fill_holes(range_m: Float[Tensor, "B h w"], passes: int) -> Float[Tensor, "B h w"]:
    """Gives pixels without a range (inf) the farthest of their four neighbours' ranges, that many times over.

    The farthest, since holes open beside the edges of near things, where what lies behind comes into view.
    """
    for _ in range(passes):
        sides = [range_m.roll(1, -1), range_m.roll(-1, -1)]
        edge = torch.full_like(range_m[:, :1], float("inf"))
        sides += [torch.cat([edge, range_m[:, :-1]], 1), torch.cat([range_m[:, 1:], edge], 1)]
        around = torch.stack(sides)
        farthest = torch.where(around.isinf(), -1.0, around).amax(0)
        range_m = torch.where(range_m.isinf() & (farthest > 0), farthest, range_m)
    return range_m


def merge_cameras(
    range_m: Float[Tensor, "B N H W"],
    value: Float[Tensor, "B N H W"],
    drawn: Bool[Tensor, "B N H W"],
    rig: Rig,
    panorama: Equirectangular,
) -> tuple[Float[Tensor, "B h w"], Float[Tensor, "B h w"]]:
    """Ranges from the cameras' own centres -> ranges from the ego origin, and values; see `draw_nearest`.

    Args:
        range_m: on maps that span the images; finite.
        value: goes with the range that wins; above 0.
        drawn: pixels that count, beside what lens and mask let the camera see.
        rig: the cameras.
        panorama: whose pixels are filled.
    """
    rays, seen = camera_rays(rig, (range_m.shape[-1], range_m.shape[-2]), range_m.device)
    centers_m = rig.ego_from_camera[:, :3, 3].to(rays)
    points_m = centers_m[:, None, None] + range_m[..., None] * rays
    return draw_nearest(points_m.flatten(1, 3), value.flatten(1), (drawn & seen).flatten(1), panorama)
