"""NVIDIA's f-theta model (DriveWorks, NCore): a polynomial of either direction, and an affine map of the image.

The convention is NCore's, https://nvidia.github.io/ncore/data/sensor_models.html, which is that of DriveWorks,
https://developer.nvidia.com/docs/drive/drive-os/7.0.3/public/drive-os-linux-sdk-api-ref/structdwFThetaCameraConfig.html
"""

import math
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import rays_at_radius, rays_of_polynomial, theta_over_radius
from omniocc.camera.ops.pixels import farthest_px, in_image
from omniocc.camera.ops.polynomial import (
    MAX_COEFFICIENTS,
    derivative,
    evaluate,
    invert_polynomial,
    positive_until,
)
from omniocc.camera.protocol import angle_from_axis, check_fields, numbers, pair, positive, scaled_center


@dataclass(frozen=True)
class FTheta:
    """Fisheye whose image radius is a polynomial of the angle, or whose angle is a polynomial of the image radius.

    NVIDIA's files hold both polynomials and say which one is the reference; the other one is a first guess at its
    inverse. Here the reference alone is kept and inverted to rounding. Whole numbers are pixel centres there too.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        center_px: (cx, cy) of the optical axis.
        angle_to_pixeldist: radius in px, ascending powers of the angle from the axis in rad; () if the other is given.
        pixeldist_to_angle: angle from the axis in rad, ascending powers of the radius in px; () if the other is given.
        linear_cde: (c, d, e): column = c * x + d * y + cx, row = e * x + y + cy, for x right and y down.
        max_angle_deg: largest angle from the optical axis that the lens sees; at 180 the polynomial alone sets it.
    """

    width: int
    height: int
    center_px: tuple[float, float]
    angle_to_pixeldist: tuple[float, ...]
    pixeldist_to_angle: tuple[float, ...]
    linear_cde: tuple[float, ...]
    max_angle_deg: float

    def __post_init__(self) -> None:
        polynomial = partial(numbers, least=0, most=MAX_COEFFICIENTS)
        checks = {
            "center_px": pair,
            "angle_to_pixeldist": polynomial,
            "pixeldist_to_angle": polynomial,
            "linear_cde": partial(numbers, least=3, most=3),
            "max_angle_deg": angle_from_axis,
        }
        check_fields(self, checks)
        if bool(self.angle_to_pixeldist) == bool(self.pixeldist_to_angle):
            both = f"{self.angle_to_pixeldist} and {self.pixeldist_to_angle}"
            raise ValueError(f"angle_to_pixeldist and pixeldist_to_angle are {both}; one must be [], the other not")
        name = "angle_to_pixeldist" if self.angle_to_pixeldist else "pixeldist_to_angle"
        coefficients = self.angle_to_pixeldist or self.pixeldist_to_angle
        if len(coefficients) < 2 or coefficients[0] != 0:
            raise ValueError(f"{name} is {coefficients}; it must begin with 0, the axis, and go on with a slope")
        positive(f"{name}[1]", coefficients[1])
        c, d, e = self.linear_cde
        if c - d * e <= 0:
            raise ValueError(f"linear_cde is {self.linear_cde}; c - d * e must be above 0")

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        theta_per_r, theta, defined = theta_over_radius(points)
        if self.angle_to_pixeldist:
            radius_per_theta = evaluate(self._unit_slope[1:], theta)
        else:
            near_axis = theta == 0
            away = torch.where(near_axis, 1, theta)
            radius = invert_polynomial(self._unit_slope, away, self._radius_limit)
            radius_per_theta = torch.where(near_axis, 1, radius / away)
        x, y = ((self._focal_px * radius_per_theta * theta_per_r)[..., None] * points[..., :2]).unbind(-1)
        c, d, e = self.linear_cde
        pixels = torch.stack([c * x + d * y, e * x + y], dim=-1) + points.new_tensor(self.center_px)
        return pixels, defined & (theta <= self.limit_rad) & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        u, v = (pixels - pixels.new_tensor(self.center_px)).unbind(-1)
        c, d, e = self.linear_cde
        offsets = torch.stack([u - d * v, c * v - e * u], dim=-1) / ((c - d * e) * self._focal_px)
        if self.angle_to_pixeldist:
            return rays_of_polynomial(offsets, self._unit_slope, self.limit_rad)
        limit = self._radius_limit
        rays = rays_at_radius(offsets, lambda radius: evaluate(self._unit_slope, radius.clamp(max=limit)))
        return rays, offsets.square().sum(-1) <= limit**2

    def resized(self, width: int, height: int) -> "FTheta":
        """See `Camera.resized`."""
        scale_x, scale_y = width / self.width, height / self.height
        c, d, e = self.linear_cde
        return replace(
            self,
            width=width,
            height=height,
            center_px=scaled_center(self.center_px, scale_x, scale_y),
            angle_to_pixeldist=tuple(k * scale_y for k in self.angle_to_pixeldist),
            pixeldist_to_angle=tuple(k / scale_y**power for power, k in enumerate(self.pixeldist_to_angle)),
            linear_cde=(c * scale_x / scale_y, d * scale_x / scale_y, e),
        )

    @property
    def limit_rad(self) -> float:
        """Return the largest angle from the axis, in radians, up to which every angle has a different pixel."""
        max_rad = math.radians(self.max_angle_deg)
        if self.angle_to_pixeldist:
            return positive_until(derivative(self._unit_slope), 0.0, max_rad)
        at_limit = evaluate(self._unit_slope, torch.tensor(self._radius_limit, dtype=torch.float64))
        return min(max_rad, float(at_limit))

    @property
    def _focal_px(self) -> float:
        """Return the pixels per radian on the axis, the unit of the radius in `_unit_slope` and `_radius_limit`."""
        return self.angle_to_pixeldist[1] if self.angle_to_pixeldist else 1 / self.pixeldist_to_angle[1]

    @property
    def _unit_slope(self) -> tuple[float, ...]:
        """Return the polynomial with the radius in `_focal_px`, so that radius and angle agree on the axis."""
        focal = self._focal_px
        forward = tuple(k / focal for k in self.angle_to_pixeldist)
        return forward or tuple(k * focal**power for power, k in enumerate(self.pixeldist_to_angle))

    @property
    def _radius_limit(self) -> float:
        """Return the radius at which the angle stops rising or reaches the largest one; for `pixeldist_to_angle`."""
        farthest = farthest_px(self.width, self.height, self.center_px, self.linear_cde) / self._focal_px
        rising = positive_until(derivative(self._unit_slope), 0.0, farthest)
        left_to_max = (math.radians(self.max_angle_deg), *(-k for k in self._unit_slope[1:]))
        return positive_until(left_to_max, 0.0, rising)
