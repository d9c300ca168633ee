"""Scaramuzza's omnidirectional model (OCamCalib), which OmniMVS uses."""

import math
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import min_cosine, theta_over_radius, unit
from omniocc.camera.ops.pixels import farthest_px, in_image
from omniocc.camera.ops.polynomial import (
    MAX_COEFFICIENTS,
    derivative,
    evaluate,
    invert_increasing,
    positive_until,
)
from omniocc.camera.protocol import angle_from_axis, check_fields, numbers, pair, scaled_center


@dataclass(frozen=True)
class OCam:
    """Model in which a pixel (x, y) at distance rho from the centre sees the ray (x, y, -f(rho)).

    Scaramuzza et al., IROS 2006. Calibration files hold a second polynomial, fitted to the inverse; on real cameras the
    two disagree by up to 3 px.
    With an `inverse_polynomial` `project` follows the file; without one it inverts f, exactly as `unproject` has it.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        center_px: (cx, cy); calibration files give the row first.
        polynomial: f, ascending powers of rho in px; the first is negative.
        inverse_polynomial: rho in px, ascending powers of (angle from the optical axis - pi / 2), rad; () to invert f.
        affine: (c, d, e): row = c * y + d * x + cy, column = e * y + x + cx, for x right and y down.
        max_angle_deg: largest angle from the optical axis that the lens sees; at 180 the polynomials alone set it.
    """

    width: int
    height: int
    center_px: tuple[float, float]
    polynomial: tuple[float, ...]
    inverse_polynomial: tuple[float, ...]
    affine: tuple[float, ...]
    max_angle_deg: float

    def __post_init__(self) -> None:
        checks = {
            "center_px": pair,
            "polynomial": partial(numbers, least=1, most=MAX_COEFFICIENTS),
            "inverse_polynomial": partial(numbers, least=0, most=MAX_COEFFICIENTS),
            "affine": partial(numbers, least=3, most=3),
            "max_angle_deg": angle_from_axis,
        }
        check_fields(self, checks)
        if self.polynomial[0] >= 0:
            raise ValueError(f"polynomial[0] is {self.polynomial[0]}; it must be negative (OCamCalib's convention)")
        if self.affine[0] - self.affine[1] * self.affine[2] <= 0:
            raise ValueError(f"affine is {self.affine}; c - d * e must be above 0")

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        theta_per_r, theta, defined = theta_over_radius(points)
        near_axis = theta == 0
        away = torch.where(near_axis, 1, theta)
        if self.inverse_polynomial:
            on_axis = evaluate(derivative(self.inverse_polynomial), away.new_tensor(-math.pi / 2))
            rho = evaluate(self.inverse_polynomial, away - math.pi / 2)
        else:
            on_axis = -self.polynomial[0]
            rho = invert_increasing(self._angle, self._angle_slope, away, 0.0, self._rho_limit)
        stretch = torch.where(near_axis, on_axis, rho / away) * theta_per_r
        x, y = (stretch[..., None] * points[..., :2]).unbind(-1)
        c, d, e = self.affine
        pixels = torch.stack([x + e * y, d * x + c * y], dim=-1) + points.new_tensor(self.center_px)
        return pixels, defined & (theta <= self.limit_rad) & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        u, v = (pixels - pixels.new_tensor(self.center_px)).unbind(-1)
        c, d, e = self.affine
        x, y = (c * u - e * v) / (c - d * e), (v - d * u) / (c - d * e)
        squared = x.square() + y.square()
        away = squared > 0
        rho = torch.where(away, torch.where(away, squared, 1).sqrt(), 0)
        within = rho.clamp(max=self._rho_limit)
        rays, _ = unit(torch.stack([x, y, -evaluate(self.polynomial, within)], dim=-1))
        return rays, (rho <= self._rho_limit) & (rays[..., 2] >= min_cosine(self.max_angle_deg))

    def resized(self, width: int, height: int) -> "OCam":
        """See `Camera.resized`."""
        scale_x, scale_y = width / self.width, height / self.height
        c, d, e = self.affine
        return replace(
            self,
            width=width,
            height=height,
            center_px=scaled_center(self.center_px, scale_x, scale_y),
            polynomial=tuple(a * scale_x ** (1 - power) for power, a in enumerate(self.polynomial)),
            inverse_polynomial=tuple(a * scale_x for a in self.inverse_polynomial),
            affine=(c * scale_y / scale_x, d * scale_y / scale_x, e),
        )

    @property
    def limit_rad(self) -> float:
        """Return the largest angle from the axis, in radians, up to which every angle has a different pixel."""
        if self.inverse_polynomial:
            start, end = -math.pi / 2, math.radians(self.max_angle_deg) - math.pi / 2
            return positive_until(derivative(self.inverse_polynomial), start, end) + math.pi / 2
        edge = torch.tensor(self._rho_limit, dtype=torch.float64)
        return min(math.radians(self.max_angle_deg), float(self._angle(edge)))

    @property
    def _rho_limit(self) -> float:
        """Return the rho at which the angle stops rising: where rho f'(rho) - f(rho) stops being positive."""
        rising = tuple((power - 1) * a for power, a in enumerate(self.polynomial))
        return positive_until(rising, 0.0, farthest_px(self.width, self.height, self.center_px, self.affine))

    def _angle(self, rho: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        return torch.atan2(rho, -evaluate(self.polynomial, rho))

    def _angle_slope(self, rho: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        f, slope = evaluate(self.polynomial, rho), evaluate(derivative(self.polynomial), rho)
        return (rho * slope - f) / (rho.square() + f.square())
