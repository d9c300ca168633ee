"""Equidistant fisheye: r = f * theta."""

import math
from dataclasses import dataclass, replace

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.models.kannala_brandt import KannalaBrandt
from omniocc.camera.ops.angle import rays_at_radius, theta_over_radius
from omniocc.camera.ops.pixels import in_image
from omniocc.camera.protocol import angle_from_axis, check_fields, pair, positive, scaled_center


@dataclass(frozen=True)
class Equidistant:
    """Fisheye whose image radius is proportional to the angle from the optical axis.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        focal_px: pixels per radian.
        center_px: (cx, cy) of the optical axis.
        max_angle_deg: largest angle from the optical axis that the lens sees; 95 for a lens of 190 degrees.
    """

    width: int
    height: int
    focal_px: float
    center_px: tuple[float, float]
    max_angle_deg: float

    def __post_init__(self) -> None:
        check_fields(self, {"focal_px": positive, "center_px": pair, "max_angle_deg": angle_from_axis})

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`. Points straight behind the camera have no single pixel and are invalid."""
        theta_per_r, theta, defined = theta_over_radius(points)
        center = points.new_tensor(self.center_px)
        pixels = self.focal_px * theta_per_r[..., None] * points[..., :2] + center
        valid = defined & (theta <= math.radians(self.max_angle_deg)) & in_image(pixels, self.width, self.height)
        return pixels, valid

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        angles = (pixels - pixels.new_tensor(self.center_px)) / self.focal_px
        valid = angles.square().sum(-1) <= math.radians(self.max_angle_deg) ** 2
        return rays_at_radius(angles, lambda theta: theta), valid

    def resized(self, width: int, height: int) -> "Equidistant | KannalaBrandt":
        """See `Camera.resized`; pixels that are no squares any more need the two focal lengths of `KannalaBrandt`."""
        scale_x, scale_y = width / self.width, height / self.height
        center = scaled_center(self.center_px, scale_x, scale_y)
        if not math.isclose(scale_x, scale_y, rel_tol=1e-9):
            focal_px = (self.focal_px * scale_x, self.focal_px * scale_y)
            return KannalaBrandt(width, height, focal_px, center, (0.0, 0.0, 0.0, 0.0), self.max_angle_deg)
        return replace(self, width=width, height=height, focal_px=self.focal_px * scale_x, center_px=center)
