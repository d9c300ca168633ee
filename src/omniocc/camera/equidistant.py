"""Equidistant fisheye: r = f * theta."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.pixels import in_image
from omniocc.camera.protocol import check_size, pair, positive, scaled_center


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
        """Raises ValueError for a size, focal length, centre or angle that no lens has."""
        check_size(self.width, self.height)
        object.__setattr__(self, "focal_px", positive("focal_px", self.focal_px))
        object.__setattr__(self, "center_px", pair("center_px", self.center_px))
        object.__setattr__(self, "max_angle_deg", positive("max_angle_deg", self.max_angle_deg))
        if self.max_angle_deg > 180:
            raise ValueError(f"max_angle_deg is {self.max_angle_deg}; it is measured from the axis and ends at 180")

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`. Points straight behind the camera have no one pixel and are invalid."""
        theta_per_r, theta, defined = _theta_over_radius(points)
        center = points.new_tensor(self.center_px)
        pixels = self.focal_px * theta_per_r[..., None] * points[..., :2] + center
        valid = defined & (theta <= math.radians(self.max_angle_deg)) & in_image(pixels, self.width, self.height)
        return pixels, valid

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        angles = (pixels - pixels.new_tensor(self.center_px)) / self.focal_px
        squared = angles.square().sum(-1)
        near_axis = squared <= torch.finfo(pixels.dtype).eps
        theta = torch.where(near_axis, 1, squared).sqrt()
        sinc = torch.where(near_axis, 1 - squared / 6, theta.sin() / theta)
        cosine = torch.where(near_axis, 1 - squared / 2, theta.cos())
        rays = torch.cat([sinc[..., None] * angles, cosine[..., None]], dim=-1)
        return rays, near_axis | (theta <= math.radians(self.max_angle_deg))

    def resized(self, width: int, height: int) -> "Equidistant":
        """See `Camera.resized`; raises ValueError if the aspect ratio changes, as the model has one focal length."""
        scale_x, scale_y = width / self.width, height / self.height
        if not math.isclose(scale_x, scale_y, rel_tol=1e-9):
            raise ValueError(
                f"an equidistant image of {self.width}x{self.height} cannot become {width}x{height}: "
                f"keep the aspect ratio, e.g. {width}x{round(width * self.height / self.width)}"
            )
        center = scaled_center(self.center_px, scale_x, scale_y)
        return replace(self, width=width, height=height, focal_px=self.focal_px * scale_x, center_px=center)


def _theta_over_radius(
    points: Float[Tensor, "*batch 3"],
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"], Bool[Tensor, "*batch"]]:
    """Angle from the axis divided by the distance from it, that angle, and whether the first is defined.

    Near the axis, where the quotient is 0/0, its series takes over; the unused branch gets harmless arguments, because
    autograd visits both.
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
