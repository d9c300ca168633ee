"""Where a ray next crosses a cell boundary, one class per kind of boundary; each holds the state of R rays.

All tensors are float64 of shape (R,). `next_m` is the distance along the ray to the next boundary of this axis (`FAR`
if there is none) and `index` the cell the ray is in on this axis, a whole number kept as float64 to save conversions.
Directions have length 1, so distances are metres.
"""

import math
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

FAR = 1e30
"""Stands for 'never': finite, so that no arithmetic on it gives nan."""
TOUCH_M = 1e-9
"""A cell crossed over less than this does not count, and a boundary this close counts as reached."""


@runtime_checkable
class Axis(Protocol):
    """State of R rays on one axis of a grid."""

    next_m: Tensor
    index: Tensor

    def advance(self, reached: Bool[Tensor, " R"]) -> None:
        """Takes the rays in `reached` over their next boundary."""
        ...

    def keep(self, rays: Int64[Tensor, " K"]) -> None:
        """Goes on with these rays only."""
        ...


class _Columns:
    """Tensors with one entry per ray that are selected together."""

    columns: tuple[str, ...]

    def keep(self, rays: Int64[Tensor, " K"]) -> None:
        for name in self.columns:
            setattr(self, name, getattr(self, name)[rays])


class Planes(_Columns):
    """Equidistant parallel planes: `low + k * size`, across one Cartesian axis."""

    columns = ("next_m", "index", "stride_m", "sign")

    def __init__(self, origin: Tensor, direction: Tensor, start_m: Tensor, bounds: tuple[float, float], cells: int):
        low, size = bounds[0], (bounds[1] - bounds[0]) / cells
        still = direction == 0
        speed = torch.where(still, 1.0, direction)
        self.index = ((origin + start_m * direction - low) / size).floor().clamp(0, cells - 1)
        self.sign = direction.sign()
        self.stride_m = torch.where(still, 0.0, size / speed.abs())
        boundary = low + (self.index + (direction > 0)) * size
        self.next_m = torch.where(still, FAR, (boundary - origin) / speed)

    def advance(self, reached: Bool[Tensor, " R"]) -> None:
        """See `Axis`."""
        step = reached.double()
        self.index.addcmul_(step, self.sign)
        self.next_m.addcmul_(step, self.stride_m)


class Rings(_Columns):
    """Concentric cylinders around the z axis.

    A ray approaches the axis, passes it at `nearest_m`, and leaves. `turn` counts the rings from the innermost one it
    reaches: negative on the way in, positive on the way out, so that it grows by one at every boundary.
    """

    columns = ("next_m", "index", "turn", "innermost", "nearest_m", "miss2", "speed2")

    def __init__(self, origin: Tensor, direction: Tensor, start_m: Tensor, bounds: tuple[float, float], cells: int):
        self.low, self.size = bounds[0], (bounds[1] - bounds[0]) / cells
        self.speed2, self.nearest_m, self.miss2 = closest_approach(origin, direction)
        self.innermost = ((self.miss2.sqrt() - self.low) / self.size).floor().clamp(-1, cells - 1)
        x, y = (origin + start_m.unsqueeze(-1) * direction)[:, :2].unbind(-1)
        ring = ((torch.sqrt(x * x + y * y) - self.low) / self.size).floor().clamp(-1, cells - 1)
        distance = (ring - self.innermost).clamp(min=0)
        self.turn = torch.where(start_m < self.nearest_m, -distance, distance)
        self._update()

    def advance(self, reached: Bool[Tensor, " R"]) -> None:
        """See `Axis`."""
        self.turn += reached
        self._update()

    def _update(self) -> None:
        leaving = self.turn >= 0
        self.index = self.innermost + self.turn.abs()
        radius = self.low + (self.index + leaving) * self.size
        offset = ((radius * radius - self.miss2).clamp_(min=0) / self.speed2).sqrt_()
        self.next_m = torch.where(leaving, self.nearest_m + offset, self.nearest_m - offset).clamp_(max=FAR)


class Sectors(_Columns):
    """Half-planes that start at the z axis, `cells` of them, the first towards -x.

    A ray sweeps less than half a turn, always the same way; one that meets the axis changes to the opposite sector.
    """

    columns = ("next_m", "index", "sweep", "axial", "after", "origin", "direction")

    def __init__(self, origin: Tensor, direction: Tensor, start_m: Tensor, cells: int):
        self.cells = cells
        angle = torch.linspace(-math.pi, math.pi, cells + 1, dtype=origin.dtype, device=origin.device)
        self.sin, self.cos = angle.sin(), angle.cos()
        self.origin, self.direction = origin[:, :2], direction[:, :2]
        speed2, nearest_m, miss2 = closest_approach(origin, direction)
        vertical = speed2 < TOUCH_M**2
        meets = (miss2 < TOUCH_M**2) & ~vertical
        self.axial = meets | vertical
        self.sweep = (origin[:, 0] * direction[:, 1] - origin[:, 1] * direction[:, 0]).sign()
        self.after = self._sector(self.direction)
        there = self._sector(self.origin + start_m.unsqueeze(-1) * self.direction)
        coming = meets & (start_m < nearest_m - TOUCH_M)
        self.index = torch.where(coming, self._sector(-self.direction), torch.where(meets, self.after, there))
        self.next_m = torch.where(coming, nearest_m, FAR)
        ahead = self._next(self.index, self.sweep, self.origin, self.direction, start_m)
        self.next_m = torch.where(self.axial, self.next_m, ahead)

    def advance(self, reached: Bool[Tensor, " R"]) -> None:
        """See `Axis`."""
        rays = reached.nonzero().flatten()
        axial, sweep = self.axial[rays], self.sweep[rays]
        index = self.index[rays] + sweep
        index += self.cells * ((index < 0).double() - (index >= self.cells).double())
        ahead = self._next(index, sweep, self.origin[rays], self.direction[rays], self.next_m[rays])
        self.index[rays] = torch.where(axial, self.after[rays], index)
        self.next_m[rays] = torch.where(axial, FAR, ahead)

    def _sector(self, xy: Float[Tensor, "R 2"]) -> Float[Tensor, " R"]:
        turned = (torch.atan2(xy[:, 1], xy[:, 0]) + math.pi) * (self.cells / (2 * math.pi))
        return turned.floor().remainder(self.cells)

    def _next(self, index: Tensor, sweep: Tensor, origin: Tensor, direction: Tensor, now_m: Tensor) -> Tensor:
        boundary = (index + (sweep > 0)).long()
        sin, cos = self.sin[boundary], self.cos[boundary]
        across = direction[:, 1] * cos - direction[:, 0] * sin
        distance = (origin[:, 0] * sin - origin[:, 1] * cos) / across
        # the line meets a boundary that the ray has left behind on the far side of the axis, earlier
        return torch.where((distance >= now_m - TOUCH_M) & (distance < FAR), distance, FAR)


def closest_approach(origin: Float[Tensor, "R 3"], direction: Float[Tensor, "R 3"]) -> tuple[Tensor, Tensor, Tensor]:
    """How rays pass the z axis.

    Returns:
        Squared horizontal speed, distance along the ray to the point nearest to the axis, squared radius there. A
        vertical ray counts as leaving, with a speed that brings it nowhere.
    """
    x, y, _ = origin.unbind(-1)
    along_x, along_y, _ = direction.unbind(-1)
    speed2 = along_x * along_x + along_y * along_y
    vertical = speed2 < TOUCH_M**2
    safe = torch.where(vertical, 1.0, speed2)
    nearest_m = torch.where(vertical, 0.0, -(x * along_x + y * along_y) / safe)
    miss2 = torch.where(vertical, x * x + y * y, (x * along_y - y * along_x) ** 2 / safe)
    return torch.where(vertical, FAR**-2, speed2), nearest_m, miss2


def clip_slab(origin: Tensor, direction: Tensor, bounds: tuple[float, float]) -> tuple[Tensor, Tensor]:
    """Distances at which rays enter and leave the space between two planes; enter > leave if they never do."""
    still = direction == 0
    speed = torch.where(still, 1.0, direction)
    first, second = (bounds[0] - origin) / speed, (bounds[1] - origin) / speed
    within = (origin >= bounds[0]) & (origin < bounds[1])
    always = torch.where(within, FAR, -FAR)
    return (
        torch.where(still, -always, torch.minimum(first, second)),
        torch.where(still, always, torch.maximum(first, second)),
    )


def clip_disc(origin: Float[Tensor, "R 3"], direction: Float[Tensor, "R 3"], radius_m: float) -> tuple[Tensor, Tensor]:
    """Distances at which rays enter and leave an endless cylinder around the z axis; enter > leave if they never do."""
    speed2, nearest_m, miss2 = closest_approach(origin, direction)
    offset = ((radius_m**2 - miss2).clamp(min=0) / speed2).sqrt()
    missed = miss2 >= radius_m**2
    return torch.where(missed, FAR, nearest_m - offset), torch.where(missed, -FAR, nearest_m + offset)
