"""Parts of a sketch: points of a panorama of ranges, gaps between cells and ranges, and a 3D network."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise, product
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.camera import Equirectangular
from omniocc.geometry import Grid
from omniocc.model.ops.blocks import points_in_cells
from omniocc.model.ops.norm import group_norm
from omniocc.model.ops.padding import Axes, Conv3d, Downsample, Periodic, Pointwise, check_halvings, upsample
from omniocc.model.ops.static import is_static

GAP_CHANNELS = 4
"""Channels of range gaps: known fraction, and the gap at three scales."""
KERNEL_XZ: Axes = (3, 1, 3)
KERNEL_YZ: Axes = (1, 3, 3)


def pseudo_points(
    range_m: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"], panorama: Equirectangular
) -> Float[Tensor, "B P 3"]:
    """Return the point that each pixel sees, ego frame, row by row; nan where the range is not valid."""
    points = range_m.float().unsqueeze(-1) * panorama.rays(range_m.device)
    return torch.where(valid.unsqueeze(-1), points, torch.nan).flatten(1, 2)


def non_periodic_axes(geometry: Grid) -> list[int]:
    """Return the axes that do not wrap around."""
    return [axis for axis in range(3) if not geometry.periodic[axis]]


def point_features(
    points: Float[Tensor, "P 3"], positions: Float[Tensor, "3 P"], geometry: Grid
) -> Float[Tensor, "P F"]:
    """Return Cylinder3D's features of points in the grid (ego frame, m): offset in the cell, position, range.

    Offsets from the cell's centre are in cells, positions from -1 to 1 over the grid, ranges in units of the grid's
    reach. Cylinder3D's azimuth, x and y are left out in a cylinder, so that turning the car turns the sketch.
    `positions` are those of the points as `Grid.scaled` returns them.
    """
    coordinates = positions.movedim(0, -1)
    offset = coordinates - coordinates.floor() - 0.5
    axes, cells = axes_and_cells(geometry, points.device)
    position = 2 * coordinates.index_select(1, axes) / cells - 1
    return torch.cat([offset, position, points.norm(dim=-1, keepdim=True) / reach_m(geometry)], dim=-1)


@lru_cache(maxsize=16)
def axes_and_cells(geometry: Grid, device: torch.device) -> tuple[Int64[Tensor, " A"], Int64[Tensor, " A"]]:
    """Return the axes that do not wrap around, and their numbers of cells."""
    axes = non_periodic_axes(geometry)
    return torch.tensor(axes, device=device), torch.tensor([geometry.shape[axis] for axis in axes], device=device)


@lru_cache(maxsize=16)
def reach_m(geometry: Grid) -> float:
    """Return the horizontal distance of the farthest column."""
    return float(geometry.distances_m().max())


def voxel_max(
    features: Float[Tensor, "P C"], cells: Int64[Tensor, " P"], num_cells: int
) -> Float[Tensor, "num_cells C"]:
    """Return the maximum of each feature over the points of a cell, at least 0; 0 in cells without points."""
    index = cells.unsqueeze(1).expand_as(features)
    return features.new_zeros(num_cells, features.shape[1]).scatter_reduce(0, index, features, "amax")


class PointEncoder(nn.Module):
    """Encode the points of every cell: an MLP on each point, the maximum in each cell."""

    def __init__(self, geometry: Grid, channels: int):
        super().__init__()
        self.geometry = geometry
        self.channels = channels
        self.hidden = nn.Linear(4 + len(non_periodic_axes(geometry)), channels)
        self.out = nn.Linear(channels, channels)

    def forward(self, points: Float[Tensor, "B P 3"]) -> tuple[Float[Tensor, "B C X Y Z"], Float[Tensor, "B 1 X Y Z"]]:
        """Return features, at least 0 and 0 in cells without points, and the mask of cells with points (0 or 1).

        Points outside the grid or not finite are ignored.
        """
        positions = self.geometry.scaled(points)
        cells, inside = self.geometry.flat_cells(positions)
        if len(points) > 1:
            cells = cells + torch.arange(len(points), device=points.device).unsqueeze(1) * self.geometry.num_cells
        static = is_static()
        if static:
            points, cells, positions = points.flatten(0, 1), cells.flatten(), positions.flatten(1)
        else:
            points, cells = points[inside], cells[inside]
            positions = self.geometry.scaled(points)
        encoded = F.relu(self.out(F.relu(self.hidden(point_features(points, positions, self.geometry)))))
        with_mask = torch.cat([encoded, torch.ones_like(encoded[:, :1])], dim=1)
        if static:  # ignored points add zeros, which do not change the maximum
            with_mask = torch.where(inside.flatten()[:, None], with_mask, 0)
        volume = voxel_max(with_mask, cells, len(inside) * self.geometry.num_cells)
        volume = volume.reshape(len(inside), *self.geometry.shape, -1).movedim(-1, 1)
        return volume[:, :-1], volume[:, -1:]


def cell_samples(geometry: Grid, per_axis: Sequence[int]) -> Float64[Tensor, "K X Y Z 3"]:
    """Return points spread evenly in every cell, `per_axis` of them along each axis; ego frame, metres."""
    fractions = [[(index + 0.5) / count for index in range(count)] for count in per_axis]
    return points_in_cells(geometry, list(product(*fractions)))


class SamplePixels(NamedTuple):
    """Row-major index of the pixel on which each sample falls, the sample's distance, and whether a pixel sees it."""

    pixel: Int64[Tensor, "K cells"]
    distance_m: Float[Tensor, "K cells"]
    inside: Bool[Tensor, "K cells"]


def sample_pixels(geometry: Grid, panorama: Equirectangular, per_axis: Sequence[int]) -> SamplePixels:
    """Return the pixel in the direction of every sample."""
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
        Four channels. The first is the fraction of samples whose direction has a valid range. The others are means over
        all samples, to which samples without one add 0: range - distance in steps; the same in units of four steps;
        and log(range / distance), each clipped to [-1, 1]. A gap is positive in front of the seen surface (free),
        around 0 at the surface, and negative behind it (hidden, unknown).
    """
    seen = range_m.float().flatten(1)[:, samples.pixel]
    known = valid.flatten(1)[:, samples.pixel] & samples.inside
    gap = torch.where(known, (seen - samples.distance_m) / step_m, 0)
    # at least 1 mm: no division by zero
    ratio = torch.where(known, seen.clamp(min=1e-3) / samples.distance_m.clamp(min=1e-3), 1)
    return torch.stack([known.float(), gap, gap / 4, ratio.log()], dim=1).clamp(-1, 1).mean(2)


class RangeGaps(nn.Module):
    """Compute the range gaps (see `range_gaps`) of every cell of a grid; no parameters.

    Args:
        panorama: panorama of the ranges, around the ego origin.
        samples: number of samples of each cell along each axis.
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
        """Return the gaps, from finite ranges (m) and a mask of the valid ones."""
        pixels = SamplePixels(self.pixel, self.distance_m, self.inside)
        gaps = range_gaps(range_m, valid, pixels, self.geometry.cell_m[0])
        return gaps.unflatten(2, self.geometry.shape)


class ConvNorm(nn.Module):
    """Apply convolution, leaky ReLU and norm, in this order, as Cylinder3D does."""

    def __init__(self, in_channels: int, out_channels: int, kernel: Axes, periodic: Periodic):
        super().__init__()
        self.conv = Conv3d(in_channels, out_channels, kernel, periodic)
        self.norm = group_norm(out_channels)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """Return a volume of the same size."""
        return self.norm(F.leaky_relu(self.conv(volume)))


class AsymmetricBlock(nn.Module):
    """Apply an asymmetric residual block: the sum of kernels 3x1x3 then 1x3x3, and 1x3x3 then 3x1x3."""

    def __init__(self, in_channels: int, out_channels: int, periodic: Periodic):
        super().__init__()

        def branch(first: Axes, second: Axes) -> nn.Sequential:
            return nn.Sequential(
                ConvNorm(in_channels, out_channels, first, periodic),
                ConvNorm(out_channels, out_channels, second, periodic),
            )

        self.first = branch(KERNEL_XZ, KERNEL_YZ)
        self.second = branch(KERNEL_YZ, KERNEL_XZ)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """Return a volume of the same size."""
        return self.first(volume) + self.second(volume)


class Context(nn.Module):
    """Weight the volume by the sum of three gates along one axis each (dimension-decomposed context)."""

    def __init__(self, channels: int, periodic: Periodic):
        super().__init__()
        kernels: list[Axes] = [(3, 1, 1), (1, 3, 1), (1, 1, 3)]
        self.convs = nn.ModuleList(Conv3d(channels, channels, kernel, periodic) for kernel in kernels)
        self.norms = nn.ModuleList(group_norm(channels) for _ in kernels)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        """Return a volume of the same size."""
        gates = [norm(conv(volume)).sigmoid() for conv, norm in zip(self.convs, self.norms, strict=True)]
        return volume * sum(gates[1:], gates[0])


class Cylinder3D(nn.Module):
    """Apply asymmetric blocks on a pyramid of halved grids, then context; wraps around on the grid's periodic axes.

    In the manner of Cylinder3D (Zhu et al. 2021), on dense volumes: dense convolutions need no compiled library, and
    can complete parts that the panorama does not see, which sparse ones on active sites cannot. The mask of cells with
    points is an input.

    Rolling the input along a periodic axis by a multiple of 2**(levels-1) cells rolls the output.

    Args:
        in_channels: of the input volume.
        channels: of each level, finest first; multiples of 8.
        out_channels: of the output volume.

    Raises:
        ValueError: if a periodic axis cannot be halved often enough, or the channels do not split into groups.
    """

    def __init__(self, geometry: Grid, in_channels: int, channels: list[int], out_channels: int):
        super().__init__()
        check_halvings(geometry, len(channels))
        periodic = self.periodic = geometry.periodic
        pairs = list(pairwise(channels))
        self.stem = AsymmetricBlock(in_channels, channels[0], periodic)
        self.down = nn.ModuleList(Downsample(fine, coarse, periodic) for fine, coarse in pairs)
        self.encoder = nn.ModuleList(AsymmetricBlock(coarse, coarse, periodic) for _, coarse in pairs)
        self.up = nn.ModuleList(Pointwise(coarse, fine) for fine, coarse in pairs)
        self.decoder = nn.ModuleList(AsymmetricBlock(fine, fine, periodic) for fine, _ in pairs[1:])
        self.context = Context(channels[0], periodic)
        self.out = Conv3d(2 * channels[0], out_channels, 3, periodic)

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B D X Y Z"]:
        """Return logits of every cell."""
        # channels last: 3D convolutions run about a third faster on the CPU
        volume = self.stem(volume.contiguous(memory_format=torch.channels_last_3d))
        skips = []
        for down, block in zip(self.down, self.encoder, strict=True):
            skips.append(volume)
            volume = down(volume)
            volume = volume + block(volume)
        for level in reversed(range(len(self.up))):
            skip = skips.pop()
            volume = skip + upsample(self.up[level](volume), skip.shape[2:], self.periodic)
            if level:
                volume = volume + self.decoder[level - 1](volume)
        return self.out(torch.cat([self.context(volume), volume], dim=1))
