"""Gaps between distances of cells and ranges seen in their directions: in front of a surface, at it, or behind it."""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor, nn

from omniocc.camera import Equirectangular
from omniocc.geometry import Grid
from omniocc.model.ops.blocks import points_in_cells

GAP_CHANNELS = 4
"""Channels of range gaps: known fraction, and the gap at three scales."""


def cell_samples(geometry: Grid, per_axis: Sequence[int]) -> Float64[Tensor, "K X Y Z 3"]:
    """Return points spread evenly in every cell, `per_axis` of them along each axis; ego frame, metres."""
    fractions = [[(index + 0.5) / count for index in range(count)] for count in per_axis]
    return points_in_cells(geometry, list(product(*fractions)))


class SamplePixels(NamedTuple):
    """Row-major pixels in the directions of cells' samples, their distances, and whether the panorama covers them."""

    pixel: Int64[Tensor, "K cells"]
    distance_m: Float[Tensor, "K cells"]
    inside: Bool[Tensor, "K cells"]


def sample_pixels(geometry: Grid, panorama: Equirectangular, per_axis: Sequence[int]) -> SamplePixels:
    """Look up the pixel in the direction of every sample."""
    points = cell_samples(geometry, per_axis).flatten(1, 3)
    pixels, inside = panorama.project(points)
    column = pixels[..., 0].round().long().remainder(panorama.width)
    row = pixels[..., 1].round().long().clamp(0, panorama.height - 1)
    return SamplePixels(row * panorama.width + column, points.norm(dim=-1).float(), inside)


def range_gaps(
    range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"], samples: SamplePixels, step_m: float
) -> Float[Tensor, "B 4 cells"]:
    """Compare the distance of each cell's samples with the range seen in their direction.

    Returns:
        The fraction of samples whose direction has a valid range; then means over all samples, 0 for those without, of
        the gap range - distance cut off at one step and at four, and of log(range / distance) cut off at 1. Positive is
        in front of the seen surface: free. Around 0 is the surface. Negative is hidden behind it: unknown.
    """
    seen = range_m.float().flatten(1)[:, samples.pixel]
    known = valid.flatten(1)[:, samples.pixel] & samples.inside
    gap = torch.where(known, (seen - samples.distance_m) / step_m, 0)
    ratio = torch.where(known, seen.clamp(min=1e-3) / samples.distance_m.clamp(min=1e-3), 1)
    parts = [known.float(), gap.clamp(-1, 1), (gap / 4).clamp(-1, 1), ratio.log().clamp(-1, 1)]
    return torch.stack([part.mean(1) for part in parts], dim=1)


class RangeGaps(nn.Module):
    """Compute the range gaps (see `range_gaps`) of every cell of a grid; no parameters.

    Args:
        panorama: of the ranges, around the ego origin.
        samples: points of each cell along each axis.
    """

    pixel: Tensor
    distance_m: Tensor
    inside: Tensor

    def __init__(self, geometry: Grid, panorama: Equirectangular, samples: Sequence[int]):
        super().__init__()
        self.geometry = geometry
        pixels = sample_pixels(geometry, panorama, samples)
        for name, tensor in pixels._asdict().items():
            self.register_buffer(name, tensor, persistent=False)

    def forward(self, range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"]) -> Float[Tensor, "B 4 X Y Z"]:
        """Return the gaps from finite ranges (m) and where they are valid."""
        pixels = SamplePixels(self.pixel, self.distance_m, self.inside)
        gaps = range_gaps(range_m, valid, pixels, self.geometry.cell_m[0])
        return gaps.unflatten(2, self.geometry.shape)
