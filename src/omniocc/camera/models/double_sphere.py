"""Double sphere: two unit spheres and a pinhole, with an inverse in closed form."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import min_cosine, pinhole_bound, unit
from omniocc.camera.ops.focal_camera import FocalCamera
from omniocc.camera.protocol import angle_from_axis, check_fields, finite


@dataclass(frozen=True)
class DoubleSphere(FocalCamera):
    """Double sphere model of Usenko, Demmel and Cremers, "The Double Sphere Camera Model", 3DV 2018.

    Size, focal lengths and centre are those of `FocalCamera`.

    Attributes:
        xi: distance between the centres of the two spheres, in (-1, 1].
        alpha: in [0, 1]; the pinhole is alpha / (1 - alpha) behind the centre of the second sphere.
        max_angle_deg: largest angle from the optical axis that the lens sees; at 180 the model alone sets it.
    """

    xi: float
    alpha: float
    max_angle_deg: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fields(self, {"xi": finite, "alpha": finite, "max_angle_deg": angle_from_axis})
        if not -1 < self.xi <= 1:
            raise ValueError(f"xi is {self.xi}; the double sphere model needs -1 < xi <= 1")
        if not 0 <= self.alpha <= 1:
            raise ValueError(f"alpha is {self.alpha}; the double sphere model needs 0 <= alpha <= 1")

    def _to_plane(self, points: Float[Tensor, "*batch 3"]) -> tuple[Tensor, Tensor]:
        rays, defined = unit(points)
        x, y, z = rays.unbind(-1)
        shifted = self.xi + z
        second = x.square() + y.square() + shifted.square()
        depth = self.alpha * torch.where(second > 0, second, 1).sqrt() + (1 - self.alpha) * shifted
        covered = defined & self._covers(z) & (depth > torch.finfo(z.dtype).eps)
        return rays[..., :2] / torch.where(covered, depth, 1)[..., None], covered

    def _from_plane(self, plane: Float[Tensor, "*batch 2"]) -> tuple[Tensor, Tensor]:
        covered = 1 - (2 * self.alpha - 1) * plane.square().sum(-1) > torch.finfo(plane.dtype).eps
        m = torch.where(covered[..., None], plane, 0)
        squared = m.square().sum(-1)
        root = (1 - (2 * self.alpha - 1) * squared).sqrt()
        height = (1 - self.alpha**2 * squared) / (self.alpha * root + 1 - self.alpha)
        reach = (height.square() + (1 - self.xi**2) * squared).sqrt()
        scale = (height * self.xi + reach) / (height.square() + squared)
        rays = torch.cat([scale[..., None] * m, (scale * height - self.xi)[..., None]], dim=-1)
        return rays, covered & self._covers(rays[..., 2])

    def _covers(self, cosine: Float[Tensor, "*batch"]) -> Bool[Tensor, "*batch"]:
        """Return whether model and lens cover angles from the axis: with w2 of the paper, where cosine > -w2."""
        w1 = pinhole_bound(self.alpha)
        w2 = (w1 + self.xi) / math.sqrt(2 * w1 * self.xi + self.xi**2 + 1)
        return (cosine > -w2) & (cosine >= min_cosine(self.max_angle_deg))
