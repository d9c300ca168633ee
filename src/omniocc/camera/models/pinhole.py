"""Pinhole camera without distortion."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.camera.ops.focal_camera import FocalCamera


@dataclass(frozen=True)
class Pinhole(FocalCamera):
    """Perspective projection u = fx * x / z + cx, v = fy * y / z + cy, with the attributes of `FocalCamera`.

    Only points in front of the camera (z > 0) are valid; every pixel is.
    """

    def _to_plane(self, points: Float[Tensor, "*batch 3"]) -> tuple[Tensor, Tensor]:
        z = points[..., 2:]
        in_front = z > torch.finfo(points.dtype).eps * points[..., :2].abs().amax(-1, keepdim=True)
        return points[..., :2] / torch.where(in_front, z, 1), in_front[..., 0]

    def _from_plane(self, plane: Float[Tensor, "*batch 2"]) -> tuple[Tensor, Tensor]:
        rays = torch.cat([plane, torch.ones_like(plane[..., :1])], dim=-1)
        return rays / rays.norm(dim=-1, keepdim=True), torch.ones_like(plane[..., 0], dtype=torch.bool)
