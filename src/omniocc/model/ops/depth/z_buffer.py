"""Panoramas of the nearest of many points."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera import Equirectangular

SAME_SURFACE = 1.5
"""Points of a pixel up to this many times as far as its nearest one belong to the same surface."""


def draw_front(
    points_m: Float[Tensor, "B P 3"],
    value: Float[Tensor, "B P"],
    drawn: Bool[Tensor, "B P"],
    panorama: Equirectangular,
    depth_ratio: float = SAME_SURFACE,
) -> tuple[Float[Tensor, "B h w"], Float[Tensor, "B h w"]]:
    """Return the distance from the origin to the nearest surface in each pixel, and its mean value; inf and 0 if none.

    The nearest point selects the surface. The distance is the harmonic mean over the points of that surface around the
    middle of the pixel, by bilinear weights: the nearest point itself would be too near on slanted surfaces such as the
    ground, the more so the more cameras see it. Points up to `depth_ratio` times as far as the nearest are of its
    surface; inf takes all. Points are in the ego frame; those that are not in `drawn` do not count.
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
