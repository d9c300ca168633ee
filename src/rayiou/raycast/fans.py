"""Fans: rays of a LiDAR raster with the same origin and azimuth, which cross the same columns of cells.

A ray has a parameter `s`: its horizontal position is `origin + s * azimuth`, with a horizontal vector `azimuth`, its
height `origin_z + s * slope` and its distance from the origin `s * stretch`.
"""

import hashlib
from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from rayiou.raycast.trace import unit

STEEP = 0.02
"""Least horizontal length of a unit direction in a raster: closer to vertical the parameter `s` is inaccurate."""


class RayFans(NamedTuple):
    """K origins x A azimuths x E elevations.

    Attributes:
        origins: ego frame, metres.
        azimuths: horizontal vectors.
        slopes: height gained per unit of `s`.
        stretches: distance per unit of `s`.
        order: number, among the rays from one origin, of the ray with the first azimuth and each elevation, then the
            second azimuth, and so on. The rays from one origin follow those from the one before.
    """

    origins: Float64[Tensor, "K 3"]
    azimuths: Float64[Tensor, "K A 2"]
    slopes: Float64[Tensor, "K E"]
    stretches: Float64[Tensor, "K E"]
    order: Int64[Tensor, " D"]

    @classmethod
    def single(cls, origins: Float[Tensor, "R 3"], directions: Float[Tensor, "R 3"]) -> "RayFans":
        """Return rays with nothing in common, each as one fan."""
        directions = unit(directions)
        slopes = directions[:, 2:]
        order = torch.zeros(1, dtype=torch.int64, device=origins.device)
        return cls(origins.double(), directions[:, None, :2], slopes, torch.ones_like(slopes), order)


class RayScan:
    """D directions that are cast from each of several origins.

    If every azimuth occurs with every elevation, as in the raster of a LiDAR, rays are grouped into fans, which makes
    casting fast. Azimuths and elevations count as equal within the rounding of the directions' type, so a raster given
    in float32 is cast as the exact raster it was rounded from. Any other directions are cast too, more slowly.

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
        self.raster = _raster(self.directions, 4 * torch.finfo(directions.dtype).eps)
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
        """Return origin and unit direction of every ray, all directions from the first origin, then from the next."""
        directions = self.directions.to(origins.device)
        repeated = origins.double().repeat_interleave(len(directions), dim=0)
        return repeated, directions.repeat(len(origins), 1)

    def fans(self, origins: Float[Tensor, "O 3"]) -> RayFans:
        """Return the rays from these origins (ego frame, metres), in the order of `rays`."""
        if self.raster is None:
            return RayFans.single(*self.rays(origins))
        azimuths, slopes, stretches, _, order = (part.to(origins.device) for part in self.raster)
        count = len(origins)
        azimuths, slopes, stretches = (part.expand(count, *part.shape) for part in (azimuths, slopes, stretches))
        return RayFans(origins.double(), azimuths, slopes, stretches, order)


class _Raster(NamedTuple):
    azimuths: Float64[Tensor, "A 2"]
    slopes: Float64[Tensor, " E"]
    stretches: Float64[Tensor, " E"]
    slot: Int64[Tensor, " D"]
    order: Int64[Tensor, " D"]

    def directions(self) -> Float64[Tensor, "D 3"]:
        """Return the unit directions of this raster."""
        flat = self.azimuths.unsqueeze(1).expand(-1, len(self.slopes), -1)
        rise = self.slopes.unsqueeze(-1).expand(len(self.azimuths), -1, 1)
        return (torch.cat([flat, rise], dim=-1) / self.stretches.unsqueeze(-1)).flatten(0, 1)[self.slot]


def _raster(directions: Float64[Tensor, "D 3"], tolerance: float) -> _Raster | None:
    level = directions[:, :2].norm(dim=1)
    if len(directions) < 2 or bool((level < STEEP).any()):
        return None
    azimuth_rad = torch.atan2(directions[:, 1], directions[:, 0])
    azimuth_rad = torch.where(azimuth_rad < -torch.pi + tolerance, azimuth_rad + 2 * torch.pi, azimuth_rad)
    azimuth, first_azimuth = _distinct(azimuth_rad, tolerance)
    elevation, first_elevation = _distinct(torch.atan2(directions[:, 2], level), tolerance)
    slot = azimuth * len(first_elevation) + elevation
    count = len(first_azimuth) * len(first_elevation)
    if len(first_elevation) < 2 or count != len(slot) or len(slot.unique()) != len(slot):
        return None
    azimuths = (directions[:, :2] / level.unsqueeze(1))[first_azimuth]
    return _Raster(
        azimuths.masked_fill(azimuths.abs() < tolerance, 0.0),
        (directions[:, 2] / level)[first_elevation],
        1 / level[first_elevation],
        slot,
        slot.argsort(),
    )


def _distinct(values: Float64[Tensor, " D"], tolerance: float) -> tuple[Tensor, Tensor]:
    """Return for each value its number among the distinct values, and for each distinct value the index of an entry."""
    ordered, order = values.sort()
    new = torch.cat([torch.ones_like(order[:1], dtype=torch.bool), ordered.diff() > tolerance])
    number = torch.empty_like(order)
    number[order] = new.long().cumsum(0) - 1
    return number, order[new]
