"""The common part of cylindrical and rectangular grids: what is done with volumes of their cells."""

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import torch
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt8
from torch import Tensor

from rayiou.labels import NUM_CLASSES
from rayiou.lattice import Lattice
from rayiou.raycast.crossings import Rays
from rayiou.raycast.table import cast
from rayiou.raycast.trace import Hits, RayPaths, paths
from rayiou.vote import majority_vote
from rayiou.warp import Corners, interpolate, trilinear


class Grid(Lattice):
    """Lattice with voxels, rays and motion; subclasses are frozen dataclasses, equal if their fields are."""

    def voxelize(
        self, points: Float[Tensor, "P 3"], labels: UInt8[Tensor, " P"], num_classes: int = NUM_CLASSES
    ) -> UInt8[Tensor, "X Y Z"]:
        """Return for every cell the most frequent class of its points (see `rayiou.vote.majority_vote`).

        Args:
            points: surface points in the ego frame, metres; those outside the grid do not count.
            labels: their classes, 1 .. num_classes-1, or 255 for unknown.
            num_classes: number of classes, free (0) included.

        Raises:
            ValueError: if a label is free or not a class.
        """
        cells, inside = self.flat_index(points)
        return majority_vote(cells[inside], labels[inside], self.num_cells, num_classes).reshape(self.shape)

    def dilate(
        self, mask: Bool[Tensor, "*B X Y Z"], windows: Sequence[int], edges_m: Sequence[float | int], behind: int = 0
    ) -> Bool[Tensor, "*B X Y Z"]:
        """Return a mask widened towards and away from the z axis, by more the farther a cell is (paper, section IV-B).

        In a cylinder a cell marks the `window` next cells on either side of it along r. In a cuboid it marks the cells
        that hold the points up to `window` cell lengths before and behind its middle, on the horizontal ray from the
        axis: the same region of space for cells of the same length. Heights do not change, and no mark crosses the
        axis.

        Args:
            mask: cells to widen, batch axes first.
            windows: half-width in cells for each range band, one more than there are edges.
            edges_m: distances of cell middles from the axis at which one band ends and the next begins.
            behind: further cells, in all bands, away from the axis only.

        Raises:
            ValueError: if mask, windows and edges do not fit together.
        """
        if tuple(mask.shape[-3:]) != self.shape:
            raise ValueError(f"mask must end with the grid's shape {self.shape}, got {tuple(mask.shape)}")
        rising = all(low < high for low, high in itertools.pairwise(edges_m))
        if len(windows) != len(edges_m) + 1 or not rising or min(*windows, behind) < 0:
            sizes = f"windows {tuple(windows)}, behind {behind} and edges_m {tuple(edges_m)}"
            raise ValueError(f"edges_m must increase, with one more window than edges, none negative; got {sizes}")
        origin, target = _moves(self, tuple(windows), tuple(map(float, edges_m)), behind, mask.device)
        columns = mask.reshape(-1, self.shape[0] * self.shape[1], self.shape[2])
        # sums, not assignments: several cells may mark the same one
        marks = columns.to(torch.int16)
        return marks.index_add(1, target, marks.index_select(1, origin)).bool().reshape(mask.shape)

    @property
    def radial_step_m(self) -> float:
        """Return the length of a cell on the way to the z axis."""
        return self.cell_m[0] if self.periodic[1] else min(self.cell_m[:2])

    def warp(
        self, volume: Float[Tensor, "B C X Y Z"], past_from_current: Float[Tensor, "B 4 4"]
    ) -> Float[Tensor, "B C X Y Z"]:
        """Return a past volume sampled at the positions of the current cell centres in the past frame.

        Trilinear along the grid's axes. An angle wraps around; elsewhere the half cell at the border takes the border
        cell's value, also around a cylinder's axis, across which nothing is interpolated. Cells whose centre was
        outside become 0, see `warp_valid`. The identity pose returns the volume itself, bit for bit.
        Differentiable in `volume`.

        Args:
            volume: features of a past frame in its ego frame.
            past_from_current: pose that takes current ego coordinates to those of the past frame.
        """
        table = volume.movedim(1, -1).flatten(1, 3)
        warped = [
            interpolate(rows, self.corners(pose.to(rows.device), rows.dtype))
            for rows, pose in zip(table, past_from_current, strict=True)
        ]
        return torch.stack(warped).unflatten(1, self.shape).movedim(-1, 1)

    def corners(self, past_from_current: Float[Tensor, "4 4"], dtype: torch.dtype) -> Corners:
        """Return the cells and weights (of `dtype`) of one past volume for each current cell, row-major."""
        position = self.scaled(self._moved_centers(past_from_current))
        return trilinear(position, self.shape, self.periodic, dtype)

    def warp_valid(self, past_from_current: Float[Tensor, "B 4 4"]) -> Bool[Tensor, "B X Y Z"]:
        """Return which current cells had their centre inside the past frame's grid."""
        return torch.stack([self.index(self._moved_centers(pose))[1].reshape(self.shape) for pose in past_from_current])

    def paths(self, origins: Rays, directions: Rays) -> RayPaths:
        """Return all cells that each ray crosses, in order (see `rayiou.raycast.trace.paths`)."""
        return paths(self, origins, directions)

    def cast(self, labels: UInt8[Tensor, "X Y Z"], origins: Rays, directions: Rays) -> Hits:
        """Return the first cell along each ray that is not free (see `rayiou.raycast.table.cast`)."""
        return cast(self, labels, origins, directions)

    def trace(
        self,
        labels: UInt8[Tensor, "X Y Z"],
        origins: Rays,
        directions: Rays,
        hit: Literal["exit", "entry"] = "exit",
    ) -> tuple[Float32[Tensor, " R"], UInt8[Tensor, " R"]]:
        """Return range (m) and class of the first cell along each ray that is not free (0); unknown (255) is not free.

        Args:
            labels: class of every cell.
            origins: ego frame, metres.
            directions: of any length above 0.
            hit: report the distance at which the hit cell is left (as the public RayIoU does) or entered.

        Returns:
            Range and class of each ray: without a hit the distance at which the ray leaves the grid and class free; for
            a ray that misses the grid inf and class free.

        Example:
            >>> from rayiou import Cylinder
            >>> grid = Cylinder((8, 16, 4), (0.0, 8.0), (-2.0, 2.0))
            >>> labels = torch.zeros(grid.shape, dtype=torch.uint8)
            >>> labels[5] = 4  # a round wall, from 5 to 6 m
            >>> origins, directions = torch.zeros(2, 3), torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
            >>> grid.trace(labels, origins, directions)
            (tensor([6., 2.]), tensor([4, 0], dtype=torch.uint8))
        """
        hits = cast(self, labels, origins, directions)
        return (hits.entry_m if hit == "entry" else hits.exit_m), hits.labels

    def _moved_centers(self, pose: Float[Tensor, "4 4"]) -> Float64[Tensor, "N 3"]:
        pose = pose.double()
        return (pose[:3, :3] @ _center_columns(self, pose.device) + pose[:3, 3:]).T


@lru_cache(maxsize=8)
def _center_columns(grid: Grid, device: torch.device) -> Float64[Tensor, "3 N"]:
    return grid.centers(torch.float64, device).reshape(-1, 3).T.contiguous()


@lru_cache(maxsize=8)
def _moves(
    grid: Grid, windows: tuple[int, ...], edges_m: tuple[float, ...], behind: int, device: torch.device
) -> tuple[Int64[Tensor, " M"], Int64[Tensor, " M"]]:
    """Return pairs of columns as two tensors: one that marks, and one that it marks."""
    points = grid.centers(torch.float64)[:, :, 0].flatten(0, 1)
    distance_m = grid.distances_m().flatten()
    window = torch.tensor(windows)[torch.bucketize(distance_m, torch.tensor(edges_m, dtype=torch.float64), right=True)]
    step_m = grid.radial_step_m
    pairs = [torch.zeros(0, 2, dtype=torch.int64)]
    for offset in [*range(-max(windows), 0), *range(1, max(windows) + behind + 1)]:
        moved, inside = _moved(grid, points, distance_m, offset * step_m)
        reach = window if offset < 0 else window + behind
        origin = ((reach >= abs(offset)) & inside).nonzero().flatten()
        pairs.append(torch.stack([origin, moved[origin]], dim=1))
    origin, target = torch.cat(pairs).unique(dim=0).to(device).unbind(1)
    return origin, target


def _moved(
    grid: Grid, points: Float64[Tensor, "N 3"], distance_m: Float64[Tensor, " N"], by_m: float
) -> tuple[Int64[Tensor, " N"], Bool[Tensor, " N"]]:
    """Return the column of each point moved away from the axis, and whether it is in the grid, on the same side."""
    shift = torch.zeros_like(points)
    shift[:, :2] = points[:, :2] / distance_m.clamp(min=1e-9).unsqueeze(1) * by_m
    cell, inside = grid.flat_index(points + shift)
    return cell // grid.shape[2], inside & (distance_m + by_m > -1e-6)


def as_axis(name: str, values: Sequence[float | int]) -> tuple[float, float]:
    """Return a checked (low, high) pair; raise ValueError if it is not two increasing finite numbers."""
    if len(values) != 2 or not (values[0] < values[1] and math.isfinite(values[0]) and math.isfinite(values[1])):
        raise ValueError(f"{name} must be two finite, increasing numbers (low, high) in metres, got {tuple(values)}")
    return float(values[0]), float(values[1])


def as_shape(values: Sequence[int]) -> tuple[int, int, int]:
    """Return the cells along three axes; raise ValueError if they are not three positive whole numbers."""
    if len(values) != 3 or not all(isinstance(cells, int) and cells > 0 for cells in values):
        raise ValueError(f"shape must be three positive whole numbers of cells, got {tuple(values)}")
    return values[0], values[1], values[2]
