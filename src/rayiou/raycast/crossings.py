"""Crossings of rays with the cell boundaries of one axis of a grid, all at once.

All tensors are float64. Distances are in units of the directions' length: metres where that is 1. A ray starts at
`start_m`, inside the grid; crossings before do not count.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int32, Int64
from torch import Tensor

Rays = Float[Tensor, "R 3"]
Distances = Float[Tensor, " R"]

FAR = 1e30
"""Distance that means 'never'; finite, so that arithmetic on it never gives nan."""
TOUCH_M = 1e-9
"""A cell crossed over less than this does not count, and a boundary this close counts as reached."""
FACE = 1e-10
"""A ray less than this (in sectors) below a sector's face runs along the face and belongs to the sector above it."""


class Crossings(NamedTuple):
    """Crossings of one axis by R rays, N at most.

    Attributes:
        index: cell on this axis at the start.
        at_m: distance along the ray of each crossing, in order; `FAR` or beyond the grid for none.
        step: change of the cell at each crossing.
    """

    index: Int64[Tensor, " R"]
    at_m: Float64[Tensor, "R N"]
    step: Int32[Tensor, "R N"]


def plane_crossings(
    origin: Distances, direction: Distances, start_m: Distances, bounds: tuple[float, float], cells: int
) -> Crossings:
    """Return the crossings with equidistant planes across one Cartesian axis."""
    low, size = bounds[0], (bounds[1] - bounds[0]) / cells
    sign = direction.sign()
    index = ((origin + start_m * direction - low) / size).floor().clamp(0, cells - 1)
    count = _largest(torch.where(sign > 0, cells - index, torch.where(sign < 0, index + 1, 0.0)))
    boundary = (index + (sign > 0)).unsqueeze(1) + torch.arange(count, device=origin.device) * sign.unsqueeze(1)
    still = sign == 0
    at_m = boundary.mul_(size).add_(low).sub_(origin.unsqueeze(1)).div_(torch.where(still, 1.0, direction).unsqueeze(1))
    at_m.masked_fill_(still.unsqueeze(1), FAR)
    return Crossings(index.long(), at_m, sign.int().unsqueeze(1).expand_as(at_m))


def ring_crossings(
    origin: Rays, direction: Rays, start_m: Distances, bounds: tuple[float, float], cells: int
) -> Crossings:
    """Return the crossings with concentric cylinders around the z axis; index -1 is the hole inside the first one.

    A ray approaches the axis, passes it, and leaves. `turn` counts the rings from the innermost one it reaches,
    negative before the closest approach, so that it grows by one at every crossing.
    """
    low, size = bounds[0], (bounds[1] - bounds[0]) / cells
    speed2, nearest_m, miss2 = closest_approach(origin, direction)
    innermost = ((miss2.sqrt() - low) / size).floor().clamp(-1, cells - 1)
    x, y = (origin + start_m.unsqueeze(-1) * direction)[:, :2].unbind(-1)
    ring = ((torch.sqrt(x * x + y * y) - low) / size).floor().clamp(-1, cells - 1)
    distance = (ring - innermost).clamp(min=0)
    turn = torch.where(start_m < nearest_m, -distance, distance)
    # plus a half, so that the sign distinguishes inward crossings (inner boundary) from outward ones (outer boundary)
    later = (turn + 0.5).unsqueeze(1) + torch.arange(_largest(cells - innermost - turn), device=origin.device)
    radius_m = later.abs().mul_(size).add_((low + (innermost + 0.5) * size).unsqueeze(1))
    offset2 = radius_m.square_().sub_(miss2.unsqueeze(1)).clamp_(min=0).div_(speed2.unsqueeze(1))
    at_m = offset2.sqrt_().copysign_(later).add_(nearest_m.unsqueeze(1)).clamp_(max=FAR)
    return Crossings((innermost + turn.abs()).long(), at_m, later.sign_().int())


def sector_crossings(origin: Rays, direction: Rays, start_m: Distances, cells: int) -> Crossings:
    """Return the crossings with `cells` half-planes that start at the z axis, the first towards -x.

    A ray sweeps less than half a turn in one sense; a ray through the axis changes to the opposite sector.
    """
    speed2, nearest_m, miss2 = closest_approach(origin, direction)
    vertical = speed2 < TOUCH_M**2
    through_axis = (miss2 < TOUCH_M**2) & ~vertical
    after = _sector(direction, cells, FACE)
    before_axis = through_axis & (start_m < nearest_m - TOUCH_M)
    at_start = _sector(origin + start_m.unsqueeze(-1) * direction, cells, 0.0)
    index = torch.where(before_axis, _sector(-direction, cells, FACE), torch.where(through_axis, after, at_start))
    sweep = (origin[:, 0] * direction[:, 1] - origin[:, 1] * direction[:, 0]).sign().long()
    straight = through_axis | vertical
    # planes half a turn apart are the same plane, which a ray crosses once
    count = 1 if bool(straight.all()) else (cells + 1) // 2
    boundary = (index + (sweep > 0)).unsqueeze(1) + torch.arange(count, device=origin.device) * sweep.unsqueeze(1)
    boundary += cells * (boundary < 0).long() - cells * (boundary >= cells).long()
    at_m = _cross_half_planes(origin, direction, start_m, boundary, sweep, cells)
    at_m.masked_fill_(straight.unsqueeze(1), FAR)
    sweep = sweep.int().unsqueeze(1)
    step = torch.where(boundary == 0, sweep * (1 - cells), sweep)
    at_m[:, 0] = torch.where(before_axis, nearest_m, at_m[:, 0])
    step[:, 0] = torch.where(before_axis, (after - index).int(), step[:, 0])
    return Crossings(index, at_m, step)


def _cross_half_planes(
    origin: Tensor, direction: Tensor, start_m: Tensor, boundary: Int64[Tensor, "R N"], sweep: Tensor, cells: int
) -> Float64[Tensor, "R N"]:
    angle = torch.linspace(-math.pi, math.pi, cells + 1, dtype=origin.dtype, device=origin.device)[:-1]
    sin, cos = (
        table.index_select(0, boundary.flatten()).reshape(boundary.shape) for table in (angle.sin(), angle.cos())
    )
    across = direction[:, 1:2] * cos
    across.addcmul_(direction[:, :1], sin, value=-1)
    at_m = sin.mul_(origin[:, :1]).addcmul_(cos, origin[:, 1:2], value=-1).div_(across)
    # a line crosses the whole plane once: on the far side of the axis against the sweep, or before the ray begins
    near = across.mul_(sweep.unsqueeze(1)) > 0
    near &= at_m >= start_m.unsqueeze(1) - TOUCH_M
    return at_m.masked_fill_(~near, FAR).clamp_(max=FAR)


def _sector(points: Rays, cells: int, ahead: float) -> Int64[Tensor, " R"]:
    turned = (torch.atan2(points[:, 1].contiguous(), points[:, 0].contiguous()) + math.pi) * (cells / (2 * math.pi))
    return (turned + ahead).floor().remainder(cells).long()


def _largest(count: Tensor) -> int:
    return int(count.max()) if len(count) else 0


def closest_approach(origin: Rays, direction: Rays) -> tuple[Tensor, Tensor, Tensor]:
    """Return the closest approach of rays to the z axis.

    Returns:
        Squared horizontal speed, distance along the ray to the point nearest to the axis, and its squared radius. A
        vertical ray counts as leaving, at a negligible speed.
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
    """Return the distances at which rays enter and leave the space between two planes; enter > leave for a miss."""
    still = direction == 0
    speed = torch.where(still, 1.0, direction)
    first, second = (bounds[0] - origin) / speed, (bounds[1] - origin) / speed
    within = (origin >= bounds[0]) & (origin < bounds[1])
    always = torch.where(within, FAR, -FAR)
    return (
        torch.where(still, -always, torch.minimum(first, second)),
        torch.where(still, always, torch.maximum(first, second)),
    )


def clip_disc(origin: Rays, direction: Rays, radius_m: float) -> tuple[Tensor, Tensor]:
    """Return the distances at which rays enter and leave an endless cylinder around z; enter > leave for a miss."""
    speed2, nearest_m, miss2 = closest_approach(origin, direction)
    offset = ((radius_m**2 - miss2).clamp(min=0) / speed2).sqrt()
    missed = miss2 >= radius_m**2
    return torch.where(missed, FAR, nearest_m - offset), torch.where(missed, -FAR, nearest_m + offset)
