"""The rectangular voxel grid."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from rayiou.grid import Grid, as_axis, as_shape
from rayiou.raycast.crossings import Crossings, Distances, Rays, clip_slab, plane_crossings


@dataclass(frozen=True, init=False)
class Cuboid(Grid):
    """Cells along x, y and z. The defaults are the paper's comparison grid of 1.04 M cells: 0.2 m x 0.2 m x 0.4 m.

    Args:
        shape: cells along x, y, z.
        x_m: rear and front end in the ego frame.
        y_m: right and left end in the ego frame.
        height_m: lower and upper end in the ego frame.

    Raises:
        ValueError: naming the size that is impossible.
    """

    shape: tuple[int, int, int]
    x_m: tuple[float, float]
    y_m: tuple[float, float]
    height_m: tuple[float, float]

    def __init__(
        self,
        shape: Sequence[int] = (256, 256, 16),
        x_m: Sequence[float | int] = (-25.6, 25.6),
        y_m: Sequence[float | int] = (-25.6, 25.6),
        height_m: Sequence[float | int] = (-2.8, 3.6),
    ) -> None:
        object.__setattr__(self, "shape", as_shape(shape))
        object.__setattr__(self, "x_m", as_axis("x_m", x_m))
        object.__setattr__(self, "y_m", as_axis("y_m", y_m))
        object.__setattr__(self, "height_m", as_axis("height_m", height_m))

    @property
    def periodic(self) -> tuple[bool, bool, bool]:
        """Return False for all axes: none wraps around."""
        return (False, False, False)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Return the ends along x, y and z in metres."""
        return self.x_m, self.y_m, self.height_m

    @property
    def cell_m(self) -> tuple[float, float, float]:
        """Return the size of every cell in metres."""
        x, y, z = ((high - low) / cells for (low, high), cells in zip(self.bounds, self.shape, strict=True))
        return x, y, z

    def to_axes(self, points: Float[Tensor, "... 3"]) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, y, z of the points."""
        x, y, z = points.unbind(-1)
        return x, y, z

    def from_axes(self, first: Tensor, second: Tensor, third: Tensor) -> Float[Tensor, "... 3"]:
        """Return points from x, y, z."""
        return torch.stack([first, second, third], dim=-1)

    def volumes_m3(self) -> Float64[Tensor, "X Y Z"]:
        """Return the volume of every cell, which is the same for all."""
        x, y, z = self.cell_m
        return torch.full(self.shape, x * y * z, dtype=torch.float64)

    def within_sides(self, points: Float[Tensor, "... 3"], margin_m: float) -> Bool[Tensor, "..."]:
        """Return which points are more than a margin inside of the ends along x and y."""
        x, y, _ = points.unbind(-1)
        (rear, front), (right, left) = self.x_m, self.y_m
        lengthwise = (x > rear + margin_m) & (x < front - margin_m)
        return lengthwise & (y > right + margin_m) & (y < left - margin_m)

    def clip(self, origins: Rays, directions: Rays) -> tuple[Distances, Distances]:
        """Return the distances at which rays enter and leave the space between all three pairs of faces."""
        slabs = [clip_slab(origins[:, i], directions[:, i], self.bounds[i]) for i in range(3)]
        enter = torch.stack([slab[0] for slab in slabs]).amax(0)
        return enter, torch.stack([slab[1] for slab in slabs]).amin(0)

    def crossings(self, origins: Rays, directions: Rays, start_m: Distances) -> tuple[Crossings, Crossings, Crossings]:
        """Return the crossings with three sets of planes."""
        x, y, z = (
            plane_crossings(origins[:, i], directions[:, i], start_m, self.bounds[i], self.shape[i]) for i in range(3)
        )
        return x, y, z
