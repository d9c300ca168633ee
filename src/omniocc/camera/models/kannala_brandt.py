"""Kannala-Brandt fisheye with four coefficients, which OpenCV calls fisheye and Kalibr pinhole-equidistant."""

import math
from dataclasses import dataclass, replace

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import rays_at_radius, theta_over_radius
from omniocc.camera.ops.pixels import in_image
from omniocc.camera.ops.polynomial import derivative, evaluate, invert_increasing, positive_until
from omniocc.camera.protocol import angle_from_axis, check_size, numbers, pair, positive_pair, scaled_center


@dataclass(frozen=True)
class KannalaBrandt:
    """Image radius f * (theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9).

    Kannala and Brandt, PAMI 2006, eq. 6 with one focal length per axis. Past the angle where the polynomial stops
    rising two angles would share a pixel: the model ends there, at 86.9 degrees for some real lenses.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        focal_px: (fx, fy), pixels per radian on the axis.
        center_px: (cx, cy) of the optical axis.
        coefficients: (k1, k2, k3, k4).
        max_angle_deg: largest angle from the optical axis that the lens sees; 180 leaves it to the polynomial.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    coefficients: tuple[float, ...]
    max_angle_deg: float

    def __post_init__(self) -> None:
        """Raises ValueError for a parameter that no lens has."""
        check_size(self.width, self.height)
        object.__setattr__(self, "focal_px", positive_pair("focal_px", self.focal_px))
        object.__setattr__(self, "center_px", pair("center_px", self.center_px))
        object.__setattr__(self, "coefficients", numbers("coefficients", self.coefficients, 4, 4))
        object.__setattr__(self, "max_angle_deg", angle_from_axis("max_angle_deg", self.max_angle_deg))

    @property
    def limit_rad(self) -> float:
        """Largest angle from the axis that has a pixel of its own."""
        return positive_until(derivative(self._radius), 0.0, math.radians(self.max_angle_deg))

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        theta_per_r, theta, defined = theta_over_radius(points)
        stretch = evaluate((1.0, *self.coefficients), theta.square()) * theta_per_r
        pixels = stretch[..., None] * points[..., :2] * points.new_tensor(self.focal_px)
        pixels = pixels + points.new_tensor(self.center_px)
        return pixels, defined & (theta <= self.limit_rad) & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        offsets = (pixels - pixels.new_tensor(self.center_px)) / pixels.new_tensor(self.focal_px)
        rays = rays_at_radius(offsets, self._angle_at)
        farthest = evaluate(self._radius, offsets.new_tensor(self.limit_rad))
        return rays, offsets.square().sum(-1) <= farthest.square()

    def resized(self, width: int, height: int) -> "KannalaBrandt":
        """See `Camera.resized`."""
        scale_x, scale_y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            focal_px=(self.focal_px[0] * scale_x, self.focal_px[1] * scale_y),
            center_px=scaled_center(self.center_px, scale_x, scale_y),
        )

    @property
    def _radius(self) -> tuple[float, ...]:
        k1, k2, k3, k4 = self.coefficients
        return (0.0, 1.0, 0.0, k1, 0.0, k2, 0.0, k3, 0.0, k4)

    def _angle_at(self, radius: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        slope = derivative(self._radius)
        return invert_increasing(
            lambda theta: evaluate(self._radius, theta),
            lambda theta: evaluate(slope, theta),
            radius,
            0.0,
            self.limit_rad,
        )
