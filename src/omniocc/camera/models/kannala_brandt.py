"""Kannala-Brandt fisheye with four coefficients, which OpenCV calls fisheye and Kalibr pinhole-equidistant."""

import math
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from omniocc.camera.ops.angle import rays_of_polynomial, theta_over_radius
from omniocc.camera.ops.focal_camera import FocalCamera
from omniocc.camera.ops.polynomial import derivative, evaluate, positive_until
from omniocc.camera.protocol import angle_from_axis, check_fields, four_numbers


@dataclass(frozen=True)
class KannalaBrandt(FocalCamera):
    """Fisheye with image radius f * (theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9).

    Kannala and Brandt, PAMI 2006, eq. 6 with one focal length per axis. Past the angle where the polynomial stops
    rising two angles would have the same pixel: the model ends there, at 86.9 degrees for some real lenses. Size, focal
    lengths (pixels per radian on the axis) and centre are those of `FocalCamera`.

    Attributes:
        coefficients: (k1, k2, k3, k4).
        max_angle_deg: largest angle from the optical axis that the lens sees; at 180 the polynomial alone sets it.
    """

    coefficients: tuple[float, ...]
    max_angle_deg: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fields(self, {"coefficients": four_numbers, "max_angle_deg": angle_from_axis})

    @property
    def limit_rad(self) -> float:
        """Return the largest angle from the axis, in radians, up to which every angle has a different pixel."""
        return positive_until(derivative(self._radius), 0.0, math.radians(self.max_angle_deg))

    def _to_plane(self, points: Float[Tensor, "*batch 3"]) -> tuple[Tensor, Tensor]:
        theta_per_r, theta, defined = theta_over_radius(points)
        stretch = evaluate((1.0, *self.coefficients), theta.square()) * theta_per_r
        return stretch[..., None] * points[..., :2], defined & (theta <= self.limit_rad)

    def _from_plane(self, plane: Float[Tensor, "*batch 2"]) -> tuple[Tensor, Tensor]:
        return rays_of_polynomial(plane, self._radius, self.limit_rad)

    @property
    def _radius(self) -> tuple[float, ...]:
        k1, k2, k3, k4 = self.coefficients
        return (0.0, 1.0, 0.0, k1, 0.0, k2, 0.0, k3, 0.0, k4)
