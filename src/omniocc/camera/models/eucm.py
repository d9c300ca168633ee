"""Extended unified camera model: an ellipsoid and a pinhole, with an inverse in closed form."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from omniocc.camera.ops.angle import min_cosine, pinhole_bound, unit
from omniocc.camera.ops.focal_camera import FocalCamera
from omniocc.camera.protocol import angle_from_axis, check_fields, finite, positive


@dataclass(frozen=True)
class EUCM(FocalCamera):
    """Extended unified model of Khomutenko, Garcia and Martinet, RA-L 2016, as written by Usenko et al., 3DV 2018.

    Size, focal lengths and centre are those of `FocalCamera`.

    Attributes:
        alpha: position of the pinhole, in [0, 1].
        beta: squared stretch of the ellipsoid; 1 makes it the unified model's sphere.
        max_angle_deg: largest angle from the optical axis that the lens sees; at 180 the model alone sets it.
    """

    alpha: float
    beta: float
    max_angle_deg: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fields(self, {"alpha": finite, "beta": positive, "max_angle_deg": angle_from_axis})
        if not 0 <= self.alpha <= 1:
            raise ValueError(f"alpha is {self.alpha}; the extended unified model needs 0 <= alpha <= 1")

    def _to_plane(self, points: Float[Tensor, "*batch 3"]) -> tuple[Tensor, Tensor]:
        rays, defined = unit(points)
        x, y, z = rays.unbind(-1)
        squared = self.beta * (x.square() + y.square()) + z.square()
        distance = torch.where(defined, squared, 1).sqrt()
        depth = self.alpha * distance + (1 - self.alpha) * z
        in_domain = (z > -pinhole_bound(self.alpha) * distance) & (depth > torch.finfo(z.dtype).eps)
        covered = defined & in_domain & (z >= min_cosine(self.max_angle_deg))
        return rays[..., :2] / torch.where(covered, depth, 1)[..., None], covered

    def _from_plane(self, plane: Float[Tensor, "*batch 2"]) -> tuple[Tensor, Tensor]:
        bend = (2 * self.alpha - 1) * self.beta
        covered = 1 - bend * plane.square().sum(-1) > torch.finfo(plane.dtype).eps
        m = torch.where(covered[..., None], plane, 0)
        squared = m.square().sum(-1)
        root = (1 - bend * squared).sqrt()
        height = (1 - self.beta * self.alpha**2 * squared) / (self.alpha * root + 1 - self.alpha)
        rays, _ = unit(torch.cat([m, height[..., None]], dim=-1))
        return rays, covered & (rays[..., 2] >= min_cosine(self.max_angle_deg))
