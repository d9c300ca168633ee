"""Extended unified camera model: an ellipsoid and a pinhole, with an inverse in closed form."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import min_cosine, pinhole_bound, unit
from omniocc.camera.ops.pixels import in_image
from omniocc.camera.protocol import angle_from_axis, check_size, finite, pair, positive, positive_pair, scaled_center


@dataclass(frozen=True)
class EUCM:
    """Khomutenko, Garcia and Martinet, RA-L 2016, as written by Usenko et al., 3DV 2018.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        focal_px: (fx, fy).
        center_px: (cx, cy) of the optical axis.
        alpha: place of the pinhole, in [0, 1].
        beta: squared stretch of the ellipsoid; 1 makes it the unified model's sphere.
        max_angle_deg: largest angle from the optical axis that the lens sees; 180 leaves it to the model.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    alpha: float
    beta: float
    max_angle_deg: float

    def __post_init__(self) -> None:
        """Raises ValueError for a parameter that no lens has."""
        check_size(self.width, self.height)
        object.__setattr__(self, "focal_px", positive_pair("focal_px", self.focal_px))
        object.__setattr__(self, "center_px", pair("center_px", self.center_px))
        object.__setattr__(self, "alpha", finite("alpha", self.alpha))
        object.__setattr__(self, "beta", positive("beta", self.beta))
        object.__setattr__(self, "max_angle_deg", angle_from_axis("max_angle_deg", self.max_angle_deg))
        if not 0 <= self.alpha <= 1:
            raise ValueError(f"alpha is {self.alpha}; the extended unified model needs 0 <= alpha <= 1")

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        rays, somewhere = unit(points)
        x, y, z = rays.unbind(-1)
        squared = self.beta * (x.square() + y.square()) + z.square()
        distance = torch.where(somewhere, squared, 1).sqrt()
        depth = self.alpha * distance + (1 - self.alpha) * z
        in_domain = (z > -pinhole_bound(self.alpha) * distance) & (depth > torch.finfo(z.dtype).eps)
        covered = somewhere & in_domain & (z >= min_cosine(self.max_angle_deg))
        pixels = rays[..., :2] / torch.where(covered, depth, 1)[..., None] * points.new_tensor(self.focal_px)
        pixels = pixels + points.new_tensor(self.center_px)
        return pixels, covered & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        m = (pixels - pixels.new_tensor(self.center_px)) / pixels.new_tensor(self.focal_px)
        bend = (2 * self.alpha - 1) * self.beta
        covered = 1 - bend * m.square().sum(-1) > torch.finfo(m.dtype).eps
        m = torch.where(covered[..., None], m, 0)
        squared = m.square().sum(-1)
        root = (1 - bend * squared).sqrt()
        height = (1 - self.beta * self.alpha**2 * squared) / (self.alpha * root + 1 - self.alpha)
        rays, _ = unit(torch.cat([m, height[..., None]], dim=-1))
        return rays, covered & (rays[..., 2] >= min_cosine(self.max_angle_deg))

    def resized(self, width: int, height: int) -> "EUCM":
        """See `Camera.resized`."""
        scale_x, scale_y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            focal_px=(self.focal_px[0] * scale_x, self.focal_px[1] * scale_y),
            center_px=scaled_center(self.center_px, scale_x, scale_y),
        )
