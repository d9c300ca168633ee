"""Angles from the optical axis, without 0/0 on the axis."""

import math
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.polynomial import evaluate, invert_polynomial


def theta_over_radius(
    points: Float[Tensor, "*batch 3"],
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"], Bool[Tensor, "*batch"]]:
    """Return the angle from the axis divided by the distance from it, the angle, and whether the quotient is defined.

    Near the axis, where the quotient is 0/0, two terms of its series are used: the next one is below rounding there.
    The unused branch gets valid arguments, because autograd evaluates both.
    """
    x, y, z = points.unbind(-1)
    squared = x.square() + y.square()
    near_axis = squared <= torch.finfo(points.dtype).eps * z.square()
    in_front = near_axis & (z > 0)
    radius = torch.where(near_axis, 1, squared).sqrt()
    away = torch.atan2(radius, torch.where(near_axis, 1, z))
    inverse_z = torch.where(in_front, z, 1).reciprocal()
    series = inverse_z * (1 - squared * inverse_z * inverse_z / 3)
    quotient = torch.where(near_axis, torch.where(in_front, series, 0), away / radius)
    return quotient, torch.where(near_axis, 0, away), in_front | ~near_axis


def rays_at_radius(
    offsets: Float[Tensor, "*batch 2"], angle_at: Callable[[Float[Tensor, "*batch"]], Float[Tensor, "*batch"]]
) -> Float[Tensor, "*batch 3"]:
    """Return the unit rays of image points, given the angle from the axis as a function of the distance from it.

    `offsets` are scaled such that angle and distance agree to first order on the axis.
    """
    squared = offsets.square().sum(-1)
    near_axis = squared <= torch.finfo(offsets.dtype).eps
    radius = torch.where(near_axis, 1, squared).sqrt()
    theta = angle_at(radius)
    sine_per_radius = torch.where(near_axis, 1 - squared / 6, theta.sin() / radius)
    cosine = torch.where(near_axis, 1 - squared / 2, theta.cos())
    return torch.cat([sine_per_radius[..., None] * offsets, cosine[..., None]], dim=-1)


def rays_of_polynomial(
    offsets: Float[Tensor, "*batch 2"], radius: tuple[float, ...], limit_rad: float
) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
    """Return the unit rays of image points whose distance from the axis is a polynomial of the angle.

    `offsets` from the image centre are in units in which the polynomial's slope on the axis is 1; `radius` has its
    ascending coefficients. It increases up to the angle `limit_rad`; farther points are invalid.
    """
    rays = rays_at_radius(offsets, lambda distance: invert_polynomial(radius, distance, limit_rad))
    farthest = evaluate(radius, offsets.new_tensor(limit_rad))
    return rays, offsets.square().sum(-1) <= farthest.square()


def unit(points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
    """Return points moved onto the unit sphere, and whether they have a direction; the origin stays at 0."""
    # squares of far or near points in float32 would overflow or vanish
    largest = points.abs().amax(-1, keepdim=True).detach()
    scaled = points / torch.where(largest > 0, largest, 1)
    squared = scaled.square().sum(-1, keepdim=True)
    defined = squared > 0
    return scaled / torch.where(defined, squared, 1).sqrt(), defined[..., 0]


def min_cosine(max_angle_deg: float) -> float:
    """Return the cosine of the largest angle from the axis; for 180, -2, which is below every rounded cosine."""
    return math.cos(math.radians(max_angle_deg)) if max_angle_deg < 180 else -2.0


def pinhole_bound(alpha: float) -> float:
    """Return the factor w of the unified models, which cover z > -w * distance (Usenko et al., 3DV 2018)."""
    return (1 - alpha) / alpha if alpha > 0.5 else alpha / (1 - alpha)
