"""Deformable self-attention among voxels (VoxFormer, Li et al., 2023, stage 2)."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from omniocc.bounds import Count, Size
from omniocc.geometry import Grid
from omniocc.model.ops.blocks import block_means, coarsened
from omniocc.model.ops.deformable_attention import SampledAttention, ring_offsets, transposed, unravel
from omniocc.model.ops.feedforward import AttentionLayer
from omniocc.model.ops.padding import Axes, pad3d, upsample
from omniocc.model.protocols import Sketched

CHUNK_SAMPLES = 2**21
HALF: Axes = (2, 2, 2)


class Layout(NamedTuple):
    """Arrangement of the voxels among which a voxel attends.

    Attributes:
        shape: cells along each of two or three axes.
        periodic: which axes wrap around.
    """

    shape: tuple[int, ...]
    periodic: tuple[bool, ...]


def sheet(cells: int) -> Layout:
    """Return the layout of `cells` pixels as an image, as square as possible: 512x512 for 128x128x16 voxels."""
    rows = next(rows for rows in range(math.isqrt(cells), 0, -1) if cells % rows == 0)
    return Layout((rows, cells // rows), (False, False))


def sphere_offsets(heads: int, points: int) -> Float[Tensor, "3 H K"]:
    """Return the first offsets of samples, in cells: one direction for each head, 1, 2, ... cells away.

    The directions spread evenly over a sphere (Fibonacci lattice) and are stretched to the surface of a cube.
    """
    index = torch.arange(heads) + 0.5
    height = 1 - 2 * index / heads
    angle = index * math.pi * (3 - math.sqrt(5))
    radius = (1 - height.square()).sqrt()
    direction = torch.stack([radius * angle.cos(), radius * angle.sin(), height])
    direction = direction / direction.abs().amax(0)
    return direction[..., None] * torch.arange(1, points + 1)


class SelfAttention(SampledAttention):
    """Sum samples around every voxel, with offsets and weights computed from its feature.

    Args:
        channels: of the voxels' features.
        heads: a divisor of the channels.
        points: samples per head.
        layout: arrangement of the voxels.
    """

    def __init__(self, channels: int, heads: int, points: int, layout: Layout):
        axes = len(layout.shape)
        rings = ring_offsets(heads, 1, points, 1)[:, 0].transpose(0, 1)
        super().__init__(channels, channels, heads, rings if axes == 2 else sphere_offsets(heads, points), axes)
        self.points, self.layout, self.axes = points, layout, axes

    def make_table(self, voxels: Float[Tensor, "B cells C"]) -> Float[Tensor, "R D"]:
        """Return values by sample, cell and head; padded by one cell: the other end's on periodic axes, else zeros."""
        values = self.value(voxels)
        values = values.to(torch.promote_types(values.dtype, torch.float32)).transpose(1, 2)
        flat = 3 - self.axes
        volume = values.unflatten(-1, (*self.layout.shape, *[1] * flat))
        padded = pad3d(volume, (1, 1, 1 - flat), (*self.layout.periodic, *[False] * flat))  # type: ignore[arg-type]
        return padded.movedim(1, -1).reshape(-1, values.shape[1] // self.heads)

    def forward(self, queries: Float[Tensor, "Q C"], first: int, table: Float[Tensor, "R D"]) -> Float[Tensor, "Q C"]:
        """Attend from consecutive voxels of all samples, row-major, from number `first` on; see `make_table`."""
        with torch.autocast(queries.device.type, enabled=False):
            offsets, weights = self._sampling(queries.to(table.dtype))
            sample, place = unravel(first, len(queries), self.layout.shape, queries.device)
            begin = sample[:, None, None] * math.prod(cells + 2 for cells in self.layout.shape)
            sums = self.sum_among_cells(table, place[:, :, None, None] + offsets, weights, begin, *self.layout)
        return self.output(sums)

    def _sampling(self, queries: Float[Tensor, "Q C"]) -> tuple[Float[Tensor, "axes Q H K"], Float[Tensor, "Q H K"]]:
        offsets = self.offsets(queries).view(-1, self.axes, self.heads, self.points).transpose(0, 1)
        weights = transposed(self.attention, queries).view(self.heads, self.points, -1).softmax(1)
        return offsets, weights.permute(2, 0, 1).contiguous()


def refine(layer: AttentionLayer, voxels: Float[Tensor, "B cells C"], chunk: int) -> Float[Tensor, "B cells C"]:
    """Apply a layer with `SelfAttention` to `chunk` voxels at a time, which are computed again in the backward pass."""
    table = layer.attention.make_table(voxels)  # type: ignore[operator]
    chunks = voxels.reshape(-1, voxels.shape[-1]).split(chunk)
    if len(chunks) == 1:
        return layer(chunks[0], 0, table).view(voxels.shape)
    parts = [
        checkpoint(layer, queries, index * chunk, table, use_reentrant=False, preserve_rng_state=False)
        for index, queries in enumerate(chunks)
    ]
    return torch.cat(parts).view(voxels.shape)  # type: ignore[arg-type]


class Attention(nn.Module):
    """Refine by layers in which every voxel attends to samples around it, trilinear between cells.

    As the second stage of VoxFormer, but in three dimensions. Voxels that are no candidates hold the lifter's mask
    token. Positions are encoded by a learned vector for each index along the axes that do not wrap around, so that
    rolling the input along a periodic axis rolls the output. Samples beyond an end that does not wrap around are zero.

    Args:
        channels: of the volume.
        layers: of attention, each followed by a feed-forward part.
        heads: of attention, a divisor of the channels.
        points: samples per head.
        feedforward_channels: hidden channels of the feed-forward part.
        halved: attend on the grid of half the resolution, in means of 2x2x2 voxels, and come back by trilinear
            interpolation, as VoxFormer does; false: on the grid itself.
        flat: attend in two dimensions, voxels in row-major order laid out as an image that wraps around nowhere, as
            VoxFormer's released code does (128x128x16 as 512x512); false: in three.

    Raises:
        ValueError: if the heads do not divide the channels, or the grid cannot be halved.
    """

    def __init__(
        self,
        geometry: Grid,
        channels: Size,
        layers: Count,
        heads: Count,
        points: Count,
        feedforward_channels: Size,
        halved: bool = False,
        flat: bool = False,
    ):
        super().__init__()
        self.halved = halved
        self.geometry = geometry = coarsened(geometry, HALF) if halved else geometry
        self.channels = channels
        layout = sheet(geometry.num_cells) if flat else Layout(geometry.shape, geometry.periodic)
        self.places = nn.ParameterList()
        for axis, (cells, wraps) in enumerate(zip(*layout, strict=True)):
            if not wraps:
                shape = [cells if other == axis else 1 for other in range(len(layout.shape))]
                self.places.append(nn.Parameter(0.02 * torch.randn(*shape, channels)))
        self.layout = layout
        self.chunk = max(CHUNK_SAMPLES // (heads * points), 1)
        self.layers = nn.ModuleList(
            AttentionLayer(SelfAttention(channels, heads, points, layout), channels, feedforward_channels)
            for _ in range(layers)
        )

    def forward(self, volume: Float[Tensor, "B C X Y Z"], sketched: Sketched) -> Float[Tensor, "B C X Y Z"]:
        """Refine a volume."""
        if not self.halved:
            return self._attend(volume)
        return upsample(self._attend(block_means(volume, HALF)), volume.shape[2:], self.geometry.periodic)  # type: ignore[arg-type]

    def _attend(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        voxels = volume.movedim(1, -1).reshape(len(volume), *self.layout.shape, self.channels)
        for place in self.places:
            voxels = voxels + place
        voxels = voxels.flatten(1, -2)
        for layer in self.layers:
            voxels = refine(layer, voxels, self.chunk)  # type: ignore[arg-type]
        return voxels.unflatten(1, volume.shape[2:]).movedim(-1, 1)
