"""Deformable self-attention among voxels (VoxFormer, Li et al., 2023, stage 2)."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from omniocc.geometry import Grid
from omniocc.model.blocks import block_means, coarsened
from omniocc.model.multilinear import corners, sum_samples
from omniocc.model.padding import Axes, Periodic, pad3d, upsample

CHUNK_SAMPLES = 2**21
HALF: Axes = (2, 2, 2)


def sphere_offsets(heads: int, points: int) -> Float[Tensor, "3 H K"]:
    """Where samples begin, in cells: each head looks in a direction of its own, its points 1, 2, ... cells away.

    The directions spread evenly over a sphere (Fibonacci lattice) and are stretched to the surface of a cube.
    """
    index = torch.arange(heads) + 0.5
    height = 1 - 2 * index / heads
    angle = index * math.pi * (3 - math.sqrt(5))
    radius = (1 - height.square()).sqrt()
    direction = torch.stack([radius * angle.cos(), radius * angle.sin(), height])
    direction = direction / direction.abs().amax(0)
    return direction[..., None] * torch.arange(1, points + 1)


class SelfAttention(nn.Module):
    """Every voxel sums samples around itself; where and how much follows from its own feature.

    Args:
        channels: of the voxels.
        heads: a divisor of the channels.
        points: samples per head.
    """

    def __init__(self, channels: int, heads: int, points: int):
        super().__init__()
        self.heads, self.points = heads, points
        self.value = nn.Linear(channels, channels)
        self.offsets = nn.Linear(channels, 3 * heads * points)
        self.attention = nn.Linear(channels, heads * points)
        self.output = nn.Linear(channels, channels)
        for layer in (self.offsets, self.attention):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        self.offsets.bias.data.copy_(sphere_offsets(heads, points).flatten())

    def make_table(self, volume: Float[Tensor, "B X Y Z C"], periodic: Periodic) -> Float[Tensor, "R D"]:
        """Values by sample, cell and head; one cell more at every end: the other end's on periodic axes, else zeros."""
        values = self.value(volume)
        values = values.to(torch.promote_types(values.dtype, torch.float32)).movedim(-1, 1)
        return pad3d(values, (1, 1, 1), periodic).movedim(1, -1).reshape(-1, values.shape[1] // self.heads)

    def forward(
        self, queries: Float[Tensor, "Q C"], first: int, table: Float[Tensor, "R D"], geometry: Grid
    ) -> Float[Tensor, "Q C"]:
        """Attends from consecutive voxels.

        Args:
            queries: voxels of all samples in row-major order, from the first one asked for.
            first: index of the first one.
            table: from `make_table`.
            geometry: the voxel grid.
        """
        with torch.autocast(queries.device.type, enabled=False):
            offsets, weights = self._sampling(queries.to(table.dtype))
            sample, place = _unravel(first, len(queries), geometry, queries.device)
            found = corners(place[:, :, None, None] + offsets, weights, geometry.shape, geometry.periodic)
            rows = sample * math.prod(cells + 2 for cells in geometry.shape)
            head = torch.arange(self.heads, dtype=torch.int32, device=rows.device)
            row = (found.row + rows[:, None, None]) * self.heads + head[:, None]
            steps = tuple(step * self.heads for step in found.steps)
            sums = sum_samples(table, row.flatten(0, 1), found.weights.flatten(0, 1), steps)
        return self.output(sums.view(len(queries), -1))

    def _sampling(self, queries: Float[Tensor, "Q C"]) -> tuple[Float[Tensor, "3 Q H K"], Float[Tensor, "Q H K"]]:
        """Offsets in cells, and attention; softmax over a short last axis would be many times slower."""
        offsets = self.offsets(queries).view(-1, 3, self.heads, self.points).transpose(0, 1)
        scores = torch.addmm(self.attention.bias[:, None], self.attention.weight, queries.T)
        weights = scores.view(self.heads, self.points, -1).softmax(1)
        return offsets, weights.permute(2, 0, 1).contiguous()


def _unravel(first: int, count: int, geometry: Grid, device: torch.device) -> tuple[Tensor, Float[Tensor, "3 Q"]]:
    """Sample and place (in cells along each axis) of consecutive voxels of a batch."""
    index = torch.arange(first, first + count, dtype=torch.int32, device=device)
    places = []
    for cells in reversed(geometry.shape):
        places.append(index % cells)
        index = torch.div(index, cells, rounding_mode="floor")
    return index, torch.stack(places[::-1]).to(torch.float32)


class AttentionLayer(nn.Module):
    """Self-attention, add & norm, feed-forward, add & norm."""

    def __init__(self, channels: int, heads: int, points: int, feedforward_channels: int):
        super().__init__()
        self.attention = SelfAttention(channels, heads, points)
        self.attention_norm = nn.LayerNorm(channels)
        self.feedforward = nn.Sequential(
            nn.Linear(channels, feedforward_channels), nn.ReLU(), nn.Linear(feedforward_channels, channels)
        )
        self.feedforward_norm = nn.LayerNorm(channels)
        self.chunk = max(CHUNK_SAMPLES // (heads * points), 1)

    def forward(self, volume: Float[Tensor, "B X Y Z C"], geometry: Grid) -> Float[Tensor, "B X Y Z C"]:
        """Voxels go through in chunks, which training computes anew on the way back."""
        table = self.attention.make_table(volume, geometry.periodic)
        chunks = volume.reshape(-1, volume.shape[-1]).split(self.chunk)
        if len(chunks) == 1:
            return self._refine(chunks[0], 0, table, geometry).view(volume.shape)
        starts = range(0, len(chunks) * self.chunk, self.chunk)
        parts = [
            checkpoint(self._refine, chunk, first, table, geometry, use_reentrant=False, preserve_rng_state=False)
            for first, chunk in zip(starts, chunks, strict=True)
        ]
        return torch.cat(parts).view(volume.shape)  # type: ignore[arg-type]

    def _refine(
        self, queries: Float[Tensor, "Q C"], first: int, table: Float[Tensor, "R D"], geometry: Grid
    ) -> Float[Tensor, "Q C"]:
        queries = self.attention_norm(queries + self.attention(queries, first, table, geometry))
        return self.feedforward_norm(queries + self.feedforward(queries))


class Attention(nn.Module):
    """Layers in which every voxel attends to samples around it, trilinear between cells.

    As the second stage of VoxFormer, but in three dimensions. Voxels that were no candidates arrive with the one vector
    that the lifter has learned for them: that is the mask token. What is learned of a voxel's place is a vector for
    each index along the axes that do not wrap around, so that rolling the input along a periodic axis rolls the output.
    Samples beyond an end that does not wrap around are zero.

    Args:
        geometry: the voxel grid.
        channels: of the volume that comes in and goes out.
        layers: number of layers.
        heads: of attention, a divisor of the channels.
        points: samples per head.
        feedforward_channels: hidden channels of the feed-forward part.
        halved: attend on the grid of half the resolution, in means of 2x2x2 voxels, and come back by trilinear
            interpolation, as VoxFormer does; false: on the grid itself.

    Raises:
        ValueError: if the heads do not divide the channels, or the grid cannot be halved.
    """

    def __init__(
        self,
        geometry: Grid,
        channels: int,
        layers: int,
        heads: int,
        points: int,
        feedforward_channels: int,
        halved: bool = False,
    ):
        super().__init__()
        if channels % heads:
            raise ValueError(f"{channels} channels cannot be split among {heads} heads; give a divisor")
        self.halved = halved
        self.geometry = geometry = coarsened(geometry, HALF) if halved else geometry
        self.channels = channels
        self.places = nn.ParameterList()
        for axis, (cells, wraps) in enumerate(zip(geometry.shape, geometry.periodic, strict=True)):
            if not wraps:
                shape = [cells if own == axis else 1 for own in range(3)]
                self.places.append(nn.Parameter(0.02 * torch.randn(*shape, channels)))
        self.layers = nn.ModuleList(
            AttentionLayer(channels, heads, points, feedforward_channels) for _ in range(layers)
        )

    def forward(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        """Refines a volume."""
        if not self.halved:
            return self._attend(volume)
        return upsample(self._attend(block_means(volume, HALF)), volume.shape[2:], self.geometry.periodic)  # type: ignore[arg-type]

    def _attend(self, volume: Float[Tensor, "B C X Y Z"]) -> Float[Tensor, "B C X Y Z"]:
        voxels = volume.movedim(1, -1)
        for place in self.places:
            voxels = voxels + place
        for layer in self.layers:
            voxels = layer(voxels, self.geometry)
        return voxels.movedim(-1, 1)
