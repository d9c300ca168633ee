"""Pinhole camera without distortion."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.focal_camera import FocalCamera
from omniocc.camera.ops.pixels import in_image


@dataclass(frozen=True)
class Pinhole(FocalCamera):
    """Perspective projection u = fx * x / z + cx, v = fy * y / z + cy, with the attributes of `FocalCamera`."""

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`. Only points in front of the camera (z > 0) are valid."""
        z = points[..., 2:]
        in_front = z > torch.finfo(points.dtype).eps * points[..., :2].abs().amax(-1, keepdim=True)
        slopes = points[..., :2] / torch.where(in_front, z, 1)
        pixels = self._to_pixels(slopes)
        return pixels, in_front[..., 0] & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`; every pixel is valid."""
        slopes = self._to_plane(pixels)
        rays = torch.cat([slopes, torch.ones_like(slopes[..., :1])], dim=-1)
        rays = rays / rays.norm(dim=-1, keepdim=True)
        return rays, torch.ones_like(slopes[..., 0], dtype=torch.bool)
