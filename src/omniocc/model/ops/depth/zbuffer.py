"""Ranges of several cameras drawn into one panorama around the ego origin, the nearest surface in front."""

import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor
from torch.nn import functional as F

from omniocc.camera import Equirectangular, Rig
from omniocc.model.ops.padded import frame_size
from omniocc.model.ops.rig_cache import once_per_rig

SAME_SURFACE = 1.5
"""Points of a pixel up to this many times as far as its nearest one belong to the same surface."""


@once_per_rig
def camera_rays(
    rig: Rig, size: tuple[int, int], device: torch.device
) -> tuple[Float32[Tensor, "N height width 3"], Bool[Tensor, "N height width"]]:
    """Return ego-frame directions of the pixels of maps of `size` (width, height), and the mask of seen ones.

    The maps span the rig's largest image; smaller ones are padded (`omniocc.model.ops.padded`).
    """
    frame = frame_size(rig)
    rays, seen = [], []
    for k, camera in enumerate(rig.cameras):
        width, height = camera.width * size[0] // frame[0], camera.height * size[1] // frame[1]
        masks = rig.masks and rig.masks[k : k + 1]
        single = Rig((camera,), rig.ego_from_camera[k : k + 1], rig.names[k : k + 1], masks).resized(width, height)
        camera_directions, camera_seen = single.rays(0)
        padding = (0, size[0] - width, 0, size[1] - height)
        rays.append(F.pad(camera_directions, (0, 0, *padding)))
        seen.append(F.pad(camera_seen, padding))
    return torch.stack(rays).to(device), torch.stack(seen).to(device)


def draw_front(
    points_m: Float[Tensor, "B P 3"],
    value: Float[Tensor, "B P"],
    drawn: Bool[Tensor, "B P"],
    panorama: Equirectangular,
    depth_ratio: float = SAME_SURFACE,
) -> tuple[Float[Tensor, "B h w"], Float[Tensor, "B h w"]]:
    """Return the distance from the origin to the nearest surface in each pixel, and its mean value; inf and 0 if none.

    The nearest point selects the surface. The distance is the mean over the points of that surface around the middle of
    the pixel, by bilinear weights: the nearest point itself would be too near on slanted surfaces such as the ground,
    the more so the more cameras see it. Points up to `depth_ratio` times as far as the nearest are of its surface; inf
    takes all. Points are in the ego frame; those that are not in `drawn` do not count.
    """
    pixels, inside = panorama.project(points_m)
    size = panorama.height * panorama.width
    range_m = points_m.norm(dim=-1)
    nearest = range_m.new_full((len(points_m), size + 1), float("inf"))
    nearest.scatter_reduce_(1, _cell(pixels.round(), inside & drawn, panorama), range_m, "amin")
    sums = [torch.zeros_like(nearest)] * 3
    corner = pixels.floor()
    fraction = pixels - corner
    for step in ((0, 0), (1, 0), (0, 1), (1, 1)):
        offset = corner.new_tensor(step)
        weight = (1 - (fraction - offset).abs()).prod(-1)
        cell = _cell(corner + offset, inside & drawn, panorama)
        weight = torch.where(range_m <= depth_ratio * nearest.gather(1, cell), weight, 0)
        amounts = weight, weight / range_m, weight * value
        sums = [total.scatter_add(1, cell, amount) for total, amount in zip(sums, amounts, strict=True)]
    maps = (total[:, :size].unflatten(1, (panorama.height, panorama.width)) for total in (*sums, nearest))
    weight, inverse, values, nearest = maps
    found = (weight > 0) & nearest.isfinite()
    return torch.where(found, weight / inverse, torch.inf), torch.where(found, values / weight, 0)


def _cell(pixels: Float[Tensor, "B P 2"], drawn: Bool[Tensor, "B P"], panorama: Equirectangular) -> Tensor:
    """Return the index of each pixel in a flat panorama, wrapped in azimuth; beyond the last for what is not drawn."""
    column, row = pixels.long().unbind(-1)
    drawn = drawn & (row >= 0) & (row < panorama.height)
    return torch.where(drawn, row * panorama.width + column % panorama.width, panorama.height * panorama.width)


def fill_holes(range_m: Float[Tensor, "B h w"], passes: int) -> Float[Tensor, "B h w"]:
    """Fill pixels without a range (inf) with the farthest of their four neighbours' ranges, `passes` times.

    The farthest is used since holes are beside the edges of near objects, where the background becomes visible.
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
    depth_ratio: float = SAME_SURFACE,
) -> tuple[Float[Tensor, "B h w"], Float[Tensor, "B h w"]]:
    """Return ranges from the ego origin, and values, from ranges from the cameras' own centres; see `draw_front`.

    Maps span the images, ranges are finite; pixels in `drawn` are used where lens and mask let the camera see.
    """
    rays, seen = camera_rays(rig, (range_m.shape[-1], range_m.shape[-2]), range_m.device)
    centers_m = rig.ego_from_camera[:, :3, 3].to(rays)
    points_m = centers_m[:, None, None] + range_m[..., None] * rays
    return draw_front(points_m.flatten(1, 3), value.flatten(1), (drawn & seen).flatten(1), panorama, depth_ratio)
