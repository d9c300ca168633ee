"""Rays that share an origin and a heading: a LiDAR's raster, where 39 rays cross the same columns of cells.

A ray is described by its horizontal part and by how it climbs: after the way `s` along its heading it is at the height
`origin_z + s * slope` and at the distance `s * stretch`.
"""

import hashlib
from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from omniocc.geometry.raycast.trace import unit

STEEP = 0.02
"""Rays with a smaller horizontal part than this make no raster: so close to vertical, `s` means little."""


class Fans(NamedTuple):
    """K origins x A headings x E climbs.

    Attributes:
        origins: ego frame, metres.
        headings: horizontal directions.
        slopes: height gained per unit of the heading's length.
        stretches: distance per unit of the heading's length.
        order: which ray it is, among those from one origin, that has the first heading and each climb, then the second
            heading, and so on. The rays from one origin follow those from the one before.
    """

    origins: Float64[Tensor, "K 3"]
    headings: Float64[Tensor, "K A 2"]
    slopes: Float64[Tensor, "K E"]
    stretches: Float64[Tensor, "K E"]
    order: Int64[Tensor, " D"]

    @classmethod
    def single(cls, origins: Float[Tensor, "R 3"], directions: Float[Tensor, "R 3"]) -> "Fans":
        """Rays that have nothing in common, each a fan of its own."""
        directions = unit(directions)
        slopes = directions[:, 2:]
        order = torch.zeros(1, dtype=torch.int64, device=origins.device)
        return cls(origins.double(), directions[:, None, :2], slopes, torch.ones_like(slopes), order)


class Scan:
    """D directions that are cast from one origin after the other.

    If every heading occurs with every elevation, as in a LiDAR's raster, rays are grouped into fans, which is what
    makes casting fast. Headings and elevations count as equal within the rounding of the directions' type, so a raster
    given in float32 is cast as the exact raster it was rounded from. Any other directions work as well, more slowly.

    Args:
        directions: ego frame, any length but zero, in any order.

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
        return isinstance(other, Scan) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def rays(self, origins: Float[Tensor, "O 3"]) -> tuple[Float64[Tensor, "R 3"], Float64[Tensor, "R 3"]]:
        """Origin and unit direction of every ray, all directions from the first origin, then from the next."""
        directions = self.directions.to(origins.device)
        repeated = origins.double().repeat_interleave(len(directions), dim=0)
        return repeated, directions.repeat(len(origins), 1)

    def fans(self, origins: Float[Tensor, "O 3"]) -> Fans:
        """The rays from these origins (ego frame, metres), in the order of `rays`."""
        if self.raster is None:
            return Fans.single(*self.rays(origins))
        headings, slopes, stretches, _, order = (part.to(origins.device) for part in self.raster)
        count = len(origins)
        return Fans(
            origins.double(),
            headings.expand(count, -1, -1),
            slopes.expand(count, -1),
            stretches.expand(count, -1),
            order,
        )


class _Raster(NamedTuple):
    headings: Float64[Tensor, "A 2"]
    slopes: Float64[Tensor, " E"]
    stretches: Float64[Tensor, " E"]
    place: Int64[Tensor, " D"]
    order: Int64[Tensor, " D"]

    def directions(self) -> Float64[Tensor, "D 3"]:
        """The unit directions that this raster stands for."""
        flat = self.headings.unsqueeze(1).expand(-1, len(self.slopes), -1)
        rise = self.slopes.unsqueeze(-1).expand(len(self.headings), -1, 1)
        return (torch.cat([flat, rise], dim=-1) / self.stretches.unsqueeze(-1)).flatten(0, 1)[self.place]


def _raster(directions: Float64[Tensor, "D 3"], tolerance: float) -> _Raster | None:
    level = directions[:, :2].norm(dim=1)
    if len(directions) < 2 or bool((level < STEEP).any()):
        return None
    azimuth = torch.atan2(directions[:, 1], directions[:, 0])
    azimuth = torch.where(azimuth < -torch.pi + tolerance, azimuth + 2 * torch.pi, azimuth)
    heading, first_heading = _distinct(azimuth, tolerance)
    climb, first_climb = _distinct(torch.atan2(directions[:, 2], level), tolerance)
    place = heading * len(first_climb) + climb
    if len(first_climb) < 2 or len(first_heading) * len(first_climb) != len(place) or len(place.unique()) != len(place):
        return None
    headings = (directions[:, :2] / level.unsqueeze(1))[first_heading]
    return _Raster(
        headings.masked_fill(headings.abs() < tolerance, 0.0),
        (directions[:, 2] / level)[first_climb],
        1 / level[first_climb],
        place,
        place.argsort(),
    )


def _distinct(values: Float64[Tensor, " D"], tolerance: float) -> tuple[Tensor, Tensor]:
    """Number of each value among the distinct ones, and for each of those an entry that has it."""
    ordered, order = values.sort()
    new = torch.cat([torch.ones_like(order[:1], dtype=torch.bool), ordered.diff() > tolerance])
    number = torch.empty_like(order)
    number[order] = new.long().cumsum(0) - 1
    return number, order[new]
