"""Fans: rays of a LiDAR raster with the same origin and azimuth, which cross the same columns of cells.

A point of a ray has a parameter `s` of 0 or more. The vector `azimuth` is horizontal, and:

* its horizontal position is `origin + s * azimuth`;
* its height is `origin_z + s * slope`;
* its distance from the origin is `s * stretch`.
"""

import hashlib
from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from rayiou.raycast.trace import unit

MIN_HORIZONTAL = 0.02
"""Least horizontal length of a unit direction in a raster; the parameter `s` of a steeper ray is inaccurate."""


class RayFans(NamedTuple):
    """K origins x A azimuths x E elevations.

    Attributes:
        origins: ego frame, metres.
        azimuths: horizontal vectors; of length 1 in a raster, where `s` is the horizontal distance in metres.
        slopes: height gained per unit of `s`.
        stretches: distance per unit of `s`.
        order: ray `order[a * E + e]` of each origin has azimuth `a` and elevation `e`. All rays from an origin come
            before those from the next.
    """

    origins: Float64[Tensor, "K 3"]
    azimuths: Float64[Tensor, "K A 2"]
    slopes: Float64[Tensor, "K E"]
    stretches: Float64[Tensor, "K E"]
    order: Int64[Tensor, " D"]

    @classmethod
    def from_rays(cls, origins: Float[Tensor, "R 3"], directions: Float[Tensor, "R 3"]) -> "RayFans":
        """Return fans of one ray each, for rays that share no origin or azimuth."""
        directions = unit(directions)
        slopes = directions[:, 2:]
        order = torch.zeros(1, dtype=torch.int64, device=origins.device)
        return cls(origins.double(), directions[:, None, :2], slopes, torch.ones_like(slopes), order)


class RayScan:
    """D directions that are cast from each of several origins.

    If every azimuth occurs once with every elevation, as in the raster of a LiDAR, rays are grouped into fans, which
    are cast faster. Azimuths and elevations that differ by no more than the rounding of the directions' type count as
    equal, so `directions` holds those of the raster in float64. Any other directions are cast one by one.

    Args:
        directions: ego frame, of any length above 0, in any order.

    Raises:
        ValueError: if a direction has no length or is not finite.
    """

    def __init__(self, directions: Float[Tensor, "D 3"]):
        rays = directions.double()
        if not bool((torch.isfinite(rays).all(dim=1) & (rays != 0).any(dim=1)).all()):
            raise ValueError("directions must be finite and of a length above 0")
        self.directions = unit(rays)
        self.raster = _find_raster(self.directions, 4 * torch.finfo(directions.dtype).eps)
        if self.raster is not None:
            self.directions = self.raster.directions()
        self.fingerprint = hashlib.sha256(self.directions.cpu().numpy().tobytes()).hexdigest()

    def __len__(self) -> int:
        return len(self.directions)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RayScan) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def rays(self, origins: Float[Tensor, "O 3"]) -> tuple[Float64[Tensor, "R 3"], Float64[Tensor, "R 3"]]:
        """Return origin and unit direction of every ray: all directions from the first origin, then from the next."""
        directions = self.directions.to(origins.device)
        repeated = origins.double().repeat_interleave(len(directions), dim=0)
        return repeated, directions.repeat(len(origins), 1)

    def fans(self, origins: Float[Tensor, "O 3"]) -> RayFans:
        """Return the rays from these origins (ego frame, metres), in the order of `rays`."""
        if self.raster is None:
            return RayFans.from_rays(*self.rays(origins))
        azimuths, slopes, stretches, _, order = (part.to(origins.device) for part in self.raster)
        count = len(origins)
        azimuths, slopes, stretches = (part.expand(count, *part.shape) for part in (azimuths, slopes, stretches))
        return RayFans(origins.double(), azimuths, slopes, stretches, order)


class _Raster(NamedTuple):
    """A azimuths x E elevations; `slot` is the place `a * E + e` of each direction, `order` its inverse."""

    azimuths: Float64[Tensor, "A 2"]
    slopes: Float64[Tensor, " E"]
    stretches: Float64[Tensor, " E"]
    slot: Int64[Tensor, " D"]
    order: Int64[Tensor, " D"]

    def directions(self) -> Float64[Tensor, "D 3"]:
        """Return the unit directions of this raster."""
        horizontal = self.azimuths.unsqueeze(1).expand(-1, len(self.slopes), -1)
        rise = self.slopes.unsqueeze(-1).expand(len(self.azimuths), -1, 1)
        return (torch.cat([horizontal, rise], dim=-1) / self.stretches.unsqueeze(-1)).flatten(0, 1)[self.slot]


def _find_raster(directions: Float64[Tensor, "D 3"], tolerance: float) -> _Raster | None:
    """Return the raster of unit directions; None if they are none. Angles within `tolerance` (rad) are equal."""
    horizontal = directions[:, :2].norm(dim=1)
    if len(directions) < 2 or bool((horizontal < MIN_HORIZONTAL).any()):
        return None
    azimuth_rad = torch.atan2(directions[:, 1], directions[:, 0])
    # -pi and pi are one azimuth: what lies at the lower end counts at the upper one
    azimuth_rad = torch.where(azimuth_rad < -torch.pi + tolerance, azimuth_rad + 2 * torch.pi, azimuth_rad)
    azimuth, first_azimuth = _number_distinct(azimuth_rad, tolerance)
    elevation, first_elevation = _number_distinct(torch.atan2(directions[:, 2], horizontal), tolerance)
    slot = azimuth * len(first_elevation) + elevation
    count = len(first_azimuth) * len(first_elevation)
    if len(first_elevation) < 2 or count != len(slot) or len(slot.unique()) != len(slot):
        return None
    # a part within the rounding of 0 is 0: the azimuth runs along the other axis
    azimuths = (directions[:, :2] / horizontal.unsqueeze(1))[first_azimuth]
    return _Raster(
        azimuths.masked_fill(azimuths.abs() < tolerance, 0.0),
        (directions[:, 2] / horizontal)[first_elevation],
        1 / horizontal[first_elevation],
        slot,
        slot.argsort(),
    )


def _number_distinct(values: Float64[Tensor, " D"], tolerance: float) -> tuple[Tensor, Tensor]:
    """Return the number of each value among the distinct ones, and for each distinct value the index of an entry.

    Sorted values belong together while each exceeds the one before by no more than `tolerance`.
    """
    ordered, order = values.sort()
    is_new = torch.cat([torch.ones_like(order[:1], dtype=torch.bool), ordered.diff() > tolerance])
    number = torch.empty_like(order)
    number[order] = is_new.long().cumsum(0) - 1
    return number, order[is_new]
