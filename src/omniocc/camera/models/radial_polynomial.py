"""Radial polynomial in pixels, the model of the WoodScape data set."""

import math
from dataclasses import dataclass, replace

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import rays_at_radius, theta_over_radius
from omniocc.camera.ops.pixels import in_image
from omniocc.camera.ops.polynomial import derivative, evaluate, invert_increasing, positive_until
from omniocc.camera.protocol import angle_from_axis, check_size, numbers, pair, positive, scaled_center


@dataclass(frozen=True)
class RadialPolynomial:
    """Image radius k1 theta + k2 theta^2 + k3 theta^3 + k4 theta^4 in pixels (Yogamani et al., ICCV 2019).

    WoodScape's files give the centre as an offset: cx = cx_offset + width / 2 - 0.5, and likewise cy.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        coefficients_px: (k1, k2, k3, k4), px per power of a radian.
        center_px: (cx, cy) of the optical axis.
        aspect: factor on v.
        max_angle_deg: largest angle from the optical axis that the lens sees; 180 leaves it to the polynomial.
    """

    width: int
    height: int
    coefficients_px: tuple[float, ...]
    center_px: tuple[float, float]
    aspect: float
    max_angle_deg: float

    def __post_init__(self) -> None:
        """Raises ValueError for a parameter that no lens has."""
        check_size(self.width, self.height)
        object.__setattr__(self, "coefficients_px", numbers("coefficients_px", self.coefficients_px, 4, 4))
        positive("coefficients_px[0]", self.coefficients_px[0])
        object.__setattr__(self, "center_px", pair("center_px", self.center_px))
        object.__setattr__(self, "aspect", positive("aspect", self.aspect))
        object.__setattr__(self, "max_angle_deg", angle_from_axis("max_angle_deg", self.max_angle_deg))

    @property
    def limit_rad(self) -> float:
        """Largest angle from the axis that has a pixel of its own."""
        return positive_until(derivative((0.0, *self.coefficients_px)), 0.0, math.radians(self.max_angle_deg))

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        theta_per_r, theta, defined = theta_over_radius(points)
        stretch = evaluate(self.coefficients_px, theta) * theta_per_r
        pixels = stretch[..., None] * points[..., :2] * points.new_tensor([1.0, self.aspect])
        pixels = pixels + points.new_tensor(self.center_px)
        return pixels, defined & (theta <= self.limit_rad) & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        per_px = pixels.new_tensor([1.0, 1 / self.aspect]) / self.coefficients_px[0]
        offsets = (pixels - pixels.new_tensor(self.center_px)) * per_px
        rays = rays_at_radius(offsets, self._angle_at)
        farthest = evaluate(self._radius, offsets.new_tensor(self.limit_rad))
        return rays, offsets.square().sum(-1) <= farthest.square()

    def resized(self, width: int, height: int) -> "RadialPolynomial":
        """See `Camera.resized`."""
        scale_x, scale_y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            coefficients_px=tuple(k * scale_x for k in self.coefficients_px),
            center_px=scaled_center(self.center_px, scale_x, scale_y),
            aspect=self.aspect * scale_y / scale_x,
        )

    @property
    def _radius(self) -> tuple[float, ...]:
        """In units of k1, so that radius and angle agree on the axis."""
        return (0.0, *(k / self.coefficients_px[0] for k in self.coefficients_px))

    def _angle_at(self, radius: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        slope = derivative(self._radius)
        return invert_increasing(
            lambda theta: evaluate(self._radius, theta),
            lambda theta: evaluate(slope, theta),
            radius,
            0.0,
            self.limit_rad,
        )
