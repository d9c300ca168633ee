"""The cells of a grid: their layout, positions and boundaries; what tracing, dilation and all else is built on."""

from abc import ABC, abstractmethod
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from rayiou.raycast.crossings import Crossings, Distances, Rays
from rayiou.warp import fold


class Lattice(ABC):
    """Regular cells along three axes in the ego frame.

    Attributes:
        shape: number of cells along each axis.
    """

    shape: tuple[int, int, int]

    @property
    @abstractmethod
    def periodic(self) -> tuple[bool, bool, bool]:
        """Return which axes wrap around."""

    @property
    @abstractmethod
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Return lower and upper end of each axis, metres (radians for an angle); the upper end is outside."""

    @property
    @abstractmethod
    def cell_m(self) -> tuple[float, float, float]:
        """Return the extent of a cell along each axis, metres; of an angle, the arc at the middle radius."""

    @abstractmethod
    def volumes_m3(self) -> Float64[Tensor, "X Y Z"]:
        """Return the volume of every cell."""

    @abstractmethod
    def to_axes(self, points: Float[Tensor, "... 3"]) -> tuple[Tensor, Tensor, Tensor]:
        """Return the values along the three axes of Cartesian ego points in metres."""

    @abstractmethod
    def from_axes(self, first: Tensor, second: Tensor, third: Tensor) -> Float[Tensor, "... 3"]:
        """Return Cartesian ego points in metres with these values along the axes; the inverse of `to_axes`."""

    @abstractmethod
    def clip(self, origins: Rays, directions: Rays) -> tuple[Distances, Distances]:
        """Return the distances at which unit rays (float64) enter and leave the grid; enter > leave for a miss."""

    @abstractmethod
    def crossings(self, origins: Rays, directions: Rays, start_m: Distances) -> tuple[Crossings, Crossings, Crossings]:
        """Return the crossings of rays (float64), inside from `start_m` on, with the boundaries of each axis."""

    @abstractmethod
    def within_sides(self, points: Float[Tensor, "... 3"], margin_m: float) -> Bool[Tensor, "..."]:
        """Return which ego points are more than a margin inside of the outer sides, whatever their height."""

    def reaches_beyond(self, distance_m: float) -> bool:
        """Return whether the grid reaches farther than a distance from the ego origin ahead or to the left."""
        return bool(self.within_sides(distance_m * torch.eye(3)[:2], 0.0).any())

    @property
    def num_cells(self) -> int:
        """Return the number of cells in the grid."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    def edges(self, axis: int) -> Float[Tensor, " edges"]:
        """Return the cell boundaries along one axis, float64, metres (radians for an angle)."""
        low, high = self.bounds[axis]
        return torch.linspace(low, high, self.shape[axis] + 1, dtype=torch.float64)

    def centers(
        self, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
    ) -> Float[Tensor, "X Y Z 3"]:
        """Return the cell centres, the middle along each axis, as Cartesian ego points in metres."""
        middles = [(self.edges(axis)[1:] + self.edges(axis)[:-1]) / 2 for axis in range(3)]
        return self.from_axes(*torch.meshgrid(*middles, indexing="ij")).to(device=device, dtype=dtype)

    def distances_m(self) -> Float64[Tensor, "X Y"]:
        """Return the horizontal distance (m) of every column's middle from the z axis."""
        return self.centers(torch.float64)[:, :, 0, :2].norm(dim=-1)

    def neighbors(self, device: torch.device | str | None = None) -> Int64[Tensor, "X Y Z 6"]:
        """Return the neighbours of each cell across its faces: down and up along the first axis, the second, the third.

        Returns:
            Row-major indices into a volume of `shape`; -1 beyond the ends of an axis that does not wrap around. No cell
            has a neighbour across the z axis, where cells of a cylinder have only an edge in common.
        """
        flat = torch.arange(self.num_cells, device=device).reshape(self.shape)
        found = []
        for axis, wraps in enumerate(self.periodic):
            for step, end in ((1, 0), (-1, self.shape[axis] - 1)):
                moved = flat.roll(step, axis)
                found.append(moved if wraps else moved.index_fill(axis, moved.new_tensor([end]), -1))
        return torch.stack(found, dim=-1)

    def coordinates(self, points: Float[Tensor, "... 3"]) -> tuple[Tensor, Tensor, Tensor]:
        """Return the position along each axis in units of cells, at least in float32: cell i spans [i, i+1)."""
        first, second, third = self.scaled(points).unbind()
        return first, second, third

    def scaled(self, points: Float[Tensor, "... 3"]) -> Float[Tensor, "3 ..."]:
        """Return the result of `coordinates` as one tensor."""
        if points.dtype not in (torch.float32, torch.float64):
            points = points.float()
        # atan2 is an order of magnitude slower on strided input
        points = points.movedim(-1, 0).contiguous().movedim(0, -1)
        low, scale = (row.view(3, *[1] * (points.dim() - 1)) for row in _limits(self, points.dtype, points.device)[:2])
        return (torch.stack(self.to_axes(points)) - low) * scale

    def index(self, points: Float[Tensor, "... 3"]) -> tuple[Int64[Tensor, "... 3"], Bool[Tensor, "..."]]:
        """Return the cell of each ego point (metres).

        Returns:
            The index along each axis (for a point outside, that of the nearest cell) and whether the point is inside. A
            point that is not finite is outside.
        """
        first, second, third, inside = self._cells(self.scaled(points))
        return torch.stack([first, second, third], dim=-1), inside

    def flat_index(self, points: Float[Tensor, "... 3"]) -> tuple[Int64[Tensor, "..."], Bool[Tensor, "..."]]:
        """Return the result of `index` with one number per cell: the row-major index into a volume of `shape`."""
        return self.flat_cells(self.scaled(points))

    def flat_cells(self, positions: Float[Tensor, "3 ..."]) -> tuple[Int64[Tensor, "..."], Bool[Tensor, "..."]]:
        """Return the result of `flat_index` from positions that `scaled` returns."""
        first, second, third, inside = self._cells(positions)
        return (first * self.shape[1] + second) * self.shape[2] + third, inside

    def _cells(self, positions: Float[Tensor, "3 ..."]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        limits = _limits(self, positions.dtype, positions.device)[2:]
        low, high, least, most = (row.view(3, *[1] * (positions.dim() - 1)) for row in limits)
        floor = positions.floor()
        inside = ((floor >= low) & (floor <= high)).all(0)
        # the angle is wrapped as an integer: float32 can round it up to a whole turn
        whole = floor.nan_to_num(0.0).clamp(least, most).long().unbind()
        axes = zip(whole, self.shape, self.periodic, strict=True)
        first, second, third = (fold(index, cells) if wraps else index for index, cells, wraps in axes)
        return first, second, third, inside


@lru_cache(maxsize=64)
def _limits(grid: Lattice, dtype: torch.dtype, device: torch.device) -> tuple[Float[Tensor, "3"], ...]:
    """Return for each axis: its lower end, cells per unit, first and last cell inside, first and last cell to keep.

    An axis that wraps around has a turn inside at either side, and keeps a cell of it, which is folded.
    """
    columns = [
        (low, cells / (high - low), *((-cells, cells, -1, cells) if wraps else (0, cells - 1, 0, cells - 1)))
        for (low, high), cells, wraps in zip(grid.bounds, grid.shape, grid.periodic, strict=True)
    ]
    return torch.tensor(columns, dtype=torch.float64).T.to(device, dtype).unbind()
