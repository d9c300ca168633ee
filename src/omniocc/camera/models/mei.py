"""Mei's unified omnidirectional model: sphere, pinhole and Brown-Conrady distortion (OpenCV omnidir, Kalibr omni)."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import unit
from omniocc.camera.ops.pixels import in_image
from omniocc.camera.ops.polynomial import derivative, evaluate, invert_increasing, positive_until
from omniocc.camera.protocol import angle_from_axis, check_size, finite, numbers, pair, positive_pair, scaled_center

NEWTON_STEPS = 6
GRAZING = 1e-3  # below xi = 1 the model reaches infinity at cos = -xi: stop short of it by this cosine


@dataclass(frozen=True)
class MEI:
    """Mei and Rives, ICRA 2007, with distortion on the normalised plane; the fisheyes of KITTI-360.

    Past the radius where r (1 + k1 r^2 + k2 r^4) stops rising two angles would share a pixel: the model ends there.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        focal_px: generalised focal lengths (gamma1, gamma2).
        center_px: (u0, v0).
        xi: distance of the pinhole from the sphere's centre, not negative.
        distortion: (k1, k2, p1, p2), radial and tangential.
        max_angle_deg: largest angle from the optical axis that the lens sees; 180 leaves it to the model.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    xi: float
    distortion: tuple[float, ...]
    max_angle_deg: float

    def __post_init__(self) -> None:
        """Raises ValueError for a parameter that no lens has."""
        check_size(self.width, self.height)
        object.__setattr__(self, "focal_px", positive_pair("focal_px", self.focal_px))
        object.__setattr__(self, "center_px", pair("center_px", self.center_px))
        object.__setattr__(self, "xi", finite("xi", self.xi))
        object.__setattr__(self, "distortion", numbers("distortion", self.distortion, 4, 4))
        object.__setattr__(self, "max_angle_deg", angle_from_axis("max_angle_deg", self.max_angle_deg))
        if self.xi < 0:
            raise ValueError(f"xi is {self.xi}; it must not be negative")

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        rays, somewhere = unit(points)
        in_front = somewhere & (rays[..., 2] >= self._min_cosine)
        depth = torch.where(in_front, rays[..., 2] + self.xi, 1)
        plane = rays[..., :2] / depth[..., None]
        covered = in_front & (plane.square().sum(-1) <= self._limit**2)
        pixels = self._distorted(plane) * points.new_tensor(self.focal_px) + points.new_tensor(self.center_px)
        return pixels, covered & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        seen = (pixels - pixels.new_tensor(self.center_px)) / pixels.new_tensor(self.focal_px)
        plane, exact = self._undistorted(seen)
        squared = plane.square().sum(-1)
        under_root = 1 + (1 - self.xi**2) * squared
        covered = exact & (under_root >= 0) & (squared <= self._limit**2)
        root = torch.where(under_root > 0, under_root, 1).sqrt() * (under_root > 0)
        scale = (self.xi + root) / (1 + squared)
        rays, _ = unit(torch.cat([scale[..., None] * plane, (scale - self.xi)[..., None]], dim=-1))
        return rays, covered

    def resized(self, width: int, height: int) -> "MEI":
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
    def _min_cosine(self) -> float:
        """Where the sphere hides itself (xi > 1) or meets the plane of the pinhole, or where the lens ends."""
        end = -1 / self.xi if self.xi > 1 else GRAZING - self.xi
        return max(end, math.cos(math.radians(self.max_angle_deg)))

    @property
    def _limit(self) -> float:
        """Largest radius on the undistorted plane that has a pixel of its own."""
        cosine = self._min_cosine
        end = math.sqrt(1 - cosine**2) / (cosine + self.xi)
        return positive_until(derivative(self._radius), 0.0, end)

    @property
    def _radius(self) -> tuple[float, ...]:
        k1, k2, _, _ = self.distortion
        return (0.0, 1.0, 0.0, k1, 0.0, k2)

    def _distorted(self, plane: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        k1, k2, p1, p2 = self.distortion
        x, y = plane.unbind(-1)
        squared = x.square() + y.square()
        radial = 1 + squared * (k1 + k2 * squared)
        u = x * radial + 2 * p1 * x * y + p2 * (squared + 2 * x.square())
        v = y * radial + p1 * (squared + 2 * y.square()) + 2 * p2 * x * y
        return torch.stack([u, v], dim=-1)

    def _newton_step(self, plane: Float[Tensor, "*batch 2"], error: Float[Tensor, "*batch 2"]) -> Tensor:
        """Change of `plane` that removes `error`, by the distortion's Jacobian."""
        k1, k2, p1, p2 = self.distortion
        x, y = plane.unbind(-1)
        squared = x.square() + y.square()
        radial, slope = 1 + squared * (k1 + k2 * squared), 2 * (k1 + 2 * k2 * squared)
        uu = radial + slope * x.square() + 2 * p1 * y + 6 * p2 * x
        uv = slope * x * y + 2 * p1 * x + 2 * p2 * y
        vv = radial + slope * y.square() + 6 * p1 * y + 2 * p2 * x
        determinant = (uu * vv - uv * uv).clamp(min=torch.finfo(x.dtype).eps ** 0.5)
        du, dv = error.unbind(-1)
        return torch.stack([vv * du - uv * dv, uu * dv - uv * du], dim=-1) / determinant[..., None]

    def _undistorted(self, seen: Float[Tensor, "*batch 2"]) -> tuple[Tensor, Bool[Tensor, "*batch"]]:
        """Newton's method from the radial part's inverse; its last step carries the gradient. Whether it arrived."""
        limit = self._limit
        with torch.no_grad():
            radius = seen.square().sum(-1).sqrt()
            slope = derivative(self._radius)
            start = invert_increasing(
                lambda r: evaluate(self._radius, r), lambda r: evaluate(slope, r), radius, 0.0, limit
            )
            plane = seen * (start / torch.where(radius > 0, radius, 1))[..., None]
            for _ in range(NEWTON_STEPS):
                step = self._newton_step(plane, self._distorted(plane) - seen)
                plane = (plane - step).clamp(-2 * limit, 2 * limit)
            error = self._distorted(plane)
            exact = ((error - seen).abs().amax(-1)) <= 256 * torch.finfo(seen.dtype).eps * (1 + radius)
        seen = torch.where(exact[..., None], seen, error)
        return plane - self._newton_step(plane, error - seen), exact
