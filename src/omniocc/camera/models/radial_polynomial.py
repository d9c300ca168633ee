"""Radial polynomial in pixels, the model of the WoodScape dataset."""

import math
from dataclasses import dataclass, replace

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import rays_of_polynomial, theta_over_radius
from omniocc.camera.ops.pixels import in_image
from omniocc.camera.ops.polynomial import derivative, evaluate, positive_until
from omniocc.camera.protocol import angle_from_axis, check_fields, four_numbers, pair, positive, scaled_center


@dataclass(frozen=True)
class RadialPolynomial:
    """Fisheye with image radius k1 theta + k2 theta^2 + k3 theta^3 + k4 theta^4 in px (Yogamani et al., ICCV 2019).

    WoodScape's files give the centre as an offset: cx = cx_offset + width / 2 - 0.5, cy = cy_offset + height / 2 - 0.5.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        coefficients_px: (k1, k2, k3, k4), px per power of a radian.
        center_px: (cx, cy) of the optical axis.
        aspect: factor on the vertical distance from the centre.
        max_angle_deg: largest angle from the optical axis that the lens sees; at 180 the polynomial alone sets it.
    """

    width: int
    height: int
    coefficients_px: tuple[float, ...]
    center_px: tuple[float, float]
    aspect: float
    max_angle_deg: float

    def __post_init__(self) -> None:
        check_fields(self, {"coefficients_px": four_numbers, "center_px": pair})
        check_fields(self, {"aspect": positive, "max_angle_deg": angle_from_axis})
        positive("coefficients_px[0]", self.coefficients_px[0])

    @property
    def limit_rad(self) -> float:
        """Return the largest angle from the axis, in radians, up to which every angle has a different pixel."""
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
        return rays_of_polynomial(offsets, self._radius, self.limit_rad)

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
        """Return the radius in units of k1, so that radius and angle agree on the axis."""
        return (0.0, *(k / self.coefficients_px[0] for k in self.coefficients_px))
