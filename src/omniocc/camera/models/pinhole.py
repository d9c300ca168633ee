"""Pinhole camera without distortion."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.pixels import in_image
from omniocc.camera.protocol import check_size, pair, positive_pair, scaled_center


@dataclass(frozen=True)
class Pinhole:
    """Perspective projection u = fx * x / z + cx, v = fy * y / z + cy.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        focal_px: (fx, fy).
        center_px: (cx, cy), the principal point.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    center_px: tuple[float, float]

    def __post_init__(self) -> None:
        """Raises ValueError for a size, focal length or centre that no camera has."""
        check_size(self.width, self.height)
        object.__setattr__(self, "focal_px", positive_pair("focal_px", self.focal_px))
        object.__setattr__(self, "center_px", pair("center_px", self.center_px))

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`. Only points in front of the camera (z > 0) are valid."""
        z = points[..., 2:]
        in_front = z > torch.finfo(points.dtype).eps * points[..., :2].abs().amax(-1, keepdim=True)
        slopes = points[..., :2] / torch.where(in_front, z, 1)
        pixels = slopes * points.new_tensor(self.focal_px) + points.new_tensor(self.center_px)
        return pixels, in_front[..., 0] & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`; every pixel is valid."""
        slopes = (pixels - pixels.new_tensor(self.center_px)) / pixels.new_tensor(self.focal_px)
        rays = torch.cat([slopes, torch.ones_like(slopes[..., :1])], dim=-1)
        rays = rays / rays.norm(dim=-1, keepdim=True)
        return rays, torch.ones_like(slopes[..., 0], dtype=torch.bool)

    def resized(self, width: int, height: int) -> "Pinhole":
        """See `Camera.resized`."""
        scale_x, scale_y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            focal_px=(self.focal_px[0] * scale_x, self.focal_px[1] * scale_y),
            center_px=scaled_center(self.center_px, scale_x, scale_y),
        )
