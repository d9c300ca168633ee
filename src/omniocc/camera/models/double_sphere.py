"""Double sphere: two unit spheres and a pinhole, with an inverse in closed form."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import min_cosine, pinhole_bound, unit
from omniocc.camera.ops.pixels import in_image
from omniocc.camera.protocol import angle_from_axis, check_size, finite, pair, positive_pair, scaled_center


@dataclass(frozen=True)
class DoubleSphere:
    """Usenko, Demmel and Cremers, "The Double Sphere Camera Model", 3DV 2018.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        focal_px: (fx, fy).
        center_px: (cx, cy) of the optical axis.
        xi: distance between the centres of the two spheres, in (-1, 1].
        alpha: place of the pinhole behind the second sphere, in [0, 1].
        max_angle_deg: largest angle from the optical axis that the lens sees; 180 leaves it to the model.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    xi: float
    alpha: float
    max_angle_deg: float

    def __post_init__(self) -> None:
        """Raises ValueError for a parameter that no lens has."""
        check_size(self.width, self.height)
        object.__setattr__(self, "focal_px", positive_pair("focal_px", self.focal_px))
        object.__setattr__(self, "center_px", pair("center_px", self.center_px))
        object.__setattr__(self, "xi", finite("xi", self.xi))
        object.__setattr__(self, "alpha", finite("alpha", self.alpha))
        object.__setattr__(self, "max_angle_deg", angle_from_axis("max_angle_deg", self.max_angle_deg))
        if not -1 < self.xi <= 1:
            raise ValueError(f"xi is {self.xi}; the double sphere model needs -1 < xi <= 1")
        if not 0 <= self.alpha <= 1:
            raise ValueError(f"alpha is {self.alpha}; the double sphere model needs 0 <= alpha <= 1")

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        rays, somewhere = unit(points)
        x, y, z = rays.unbind(-1)
        shifted = self.xi + z
        second = x.square() + y.square() + shifted.square()
        depth = self.alpha * torch.where(second > 0, second, 1).sqrt() + (1 - self.alpha) * shifted
        covered = somewhere & (z > -self._behind) & (z >= self._min_cosine) & (depth > torch.finfo(z.dtype).eps)
        pixels = rays[..., :2] / torch.where(covered, depth, 1)[..., None] * points.new_tensor(self.focal_px)
        pixels = pixels + points.new_tensor(self.center_px)
        return pixels, covered & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        m = (pixels - pixels.new_tensor(self.center_px)) / pixels.new_tensor(self.focal_px)
        covered = 1 - (2 * self.alpha - 1) * m.square().sum(-1) > torch.finfo(m.dtype).eps
        m = torch.where(covered[..., None], m, 0)
        squared = m.square().sum(-1)
        root = (1 - (2 * self.alpha - 1) * squared).sqrt()
        height = (1 - self.alpha**2 * squared) / (self.alpha * root + 1 - self.alpha)
        reach = (height.square() + (1 - self.xi**2) * squared).sqrt()
        scale = (height * self.xi + reach) / (height.square() + squared)
        rays = torch.cat([scale[..., None] * m, (scale * height - self.xi)[..., None]], dim=-1)
        z = rays[..., 2]
        return rays, covered & (z > -self._behind) & (z >= self._min_cosine)

    def resized(self, width: int, height: int) -> "DoubleSphere":
        """See `Camera.resized`."""
        scale_x, scale_y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            focal_px=(self.focal_px[0] * scale_x, self.focal_px[1] * scale_y),
            center_px=scaled_center(self.center_px, scale_x, scale_y),
        )

    @property
    def _behind(self) -> float:
        """The paper's w2: the model covers z > -w2 * distance, which ends a tenth of a degree before its rim."""
        w1 = pinhole_bound(self.alpha)
        return (w1 + self.xi) / math.sqrt(2 * w1 * self.xi + self.xi**2 + 1)

    @property
    def _min_cosine(self) -> float:
        return min_cosine(self.max_angle_deg)
