"""Mei's unified omnidirectional model: sphere, pinhole and Brown-Conrady distortion (OpenCV omnidir, Kalibr omni)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.angle import unit
from omniocc.camera.ops.focal_camera import FocalCamera
from omniocc.camera.ops.polynomial import derivative, invert_polynomial, positive_until
from omniocc.camera.protocol import angle_from_axis, check_fields, finite, four_numbers

NEWTON_STEPS = 6  # measured: 4 bring every pixel to rounding, also at k1 = -0.2
COSINE_MARGIN = 1e-3  # below xi = 1 the model reaches infinity at cos = -xi: it ends this much before


@dataclass(frozen=True)
class MEI(FocalCamera):
    """Unified model of Mei and Rives, ICRA 2007, with distortion on the normalised plane; the fisheyes of KITTI-360.

    Past the radius where r (1 + k1 r^2 + k2 r^4) stops rising, two angles would have the same pixel: the model ends
    there. Size, focal lengths (the generalised gamma1 and gamma2) and centre (u0, v0) are those of `FocalCamera`.

    Attributes:
        xi: distance of the pinhole from the sphere's centre, not negative.
        distortion: (k1, k2, p1, p2), radial and tangential.
        max_angle_deg: largest angle from the optical axis that the lens sees; at 180 the model alone sets it.
    """

    xi: float
    distortion: tuple[float, ...]
    max_angle_deg: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fields(self, {"xi": finite, "distortion": four_numbers, "max_angle_deg": angle_from_axis})
        if self.xi < 0:
            raise ValueError(f"xi is {self.xi}; it must not be negative")

    def _to_plane(self, points: Float[Tensor, "*batch 3"]) -> tuple[Tensor, Tensor]:
        rays, defined = unit(points)
        in_front = defined & (rays[..., 2] >= self._min_cosine)
        depth = torch.where(in_front, rays[..., 2] + self.xi, 1)
        plane = rays[..., :2] / depth[..., None]
        covered = in_front & (plane.square().sum(-1) <= self._limit**2)
        return self._distorted(plane), covered

    def _from_plane(self, plane: Float[Tensor, "*batch 2"]) -> tuple[Tensor, Tensor]:
        plane, converged = self._undistorted(plane)
        squared = plane.square().sum(-1)
        under_root = 1 + (1 - self.xi**2) * squared
        covered = converged & (under_root >= 0) & (squared <= self._limit**2)
        root = torch.where(under_root > 0, under_root, 1).sqrt() * (under_root > 0)
        scale = (self.xi + root) / (1 + squared)
        rays, _ = unit(torch.cat([scale[..., None] * plane, (scale - self.xi)[..., None]], dim=-1))
        return rays, covered

    @property
    def _min_cosine(self) -> float:
        """Return the cosine of the angle where the sphere occludes itself, the model diverges or the lens ends."""
        end = -1 / self.xi if self.xi > 1 else COSINE_MARGIN - self.xi
        return max(end, math.cos(math.radians(self.max_angle_deg)))

    @property
    def _limit(self) -> float:
        """Return the largest radius on the undistorted plane up to which every angle has a different pixel."""
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
        """Return the change of `plane` that removes `error`, by the distortion's Jacobian."""
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

    def _undistorted(self, distorted: Float[Tensor, "*batch 2"]) -> tuple[Tensor, Bool[Tensor, "*batch"]]:
        """Return the points that Newton's method finds, and whether it converged; its last step has the gradient."""
        limit = self._limit
        with torch.no_grad():
            radius = distorted.square().sum(-1).sqrt()
            start = invert_polynomial(self._radius, radius, limit)
            plane = distorted * (start / torch.where(radius > 0, radius, 1))[..., None]
            for _ in range(NEWTON_STEPS):
                step = self._newton_step(plane, self._distorted(plane) - distorted)
                plane = (plane - step).clamp(-2 * limit, 2 * limit)
            reached = self._distorted(plane)
            # the distortion rounds several times, and each rounding error grows with the radius
            tolerance = 256 * torch.finfo(distorted.dtype).eps * (1 + radius)
            converged = (reached - distorted).abs().amax(-1) <= tolerance
        distorted = torch.where(converged[..., None], distorted, reached)
        return plane - self._newton_step(plane, reached - distorted), converged
