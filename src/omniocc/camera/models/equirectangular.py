"""Equirectangular (ERP) panorama around the ego origin."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from omniocc.bounds import Size
from omniocc.camera.ops.pixels import in_image, pixel_centers
from omniocc.camera.protocol import check_fields, finite


@dataclass(frozen=True)
class Equirectangular:
    """Panorama with azimuths over the full turn as columns and elevations as rows; its camera frame is the ego frame.

    Column j has the azimuth pi - (j + 0.5) * 2 pi / width: forward is the middle of the image, the car's left is its
    left. Row i has the elevation top - (i + 0.5) * (top - bottom) / height.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        top_deg: elevation of the image's upper edge.
        bottom_deg: elevation of the image's lower edge.
    """

    width: Size
    height: Size
    top_deg: float
    bottom_deg: float

    def __post_init__(self) -> None:
        check_fields(self, {"top_deg": finite, "bottom_deg": finite})
        if not -90 <= self.bottom_deg < self.top_deg <= 90:
            raise ValueError(
                f"top_deg {self.top_deg} and bottom_deg {self.bottom_deg}: need -90 <= bottom_deg < top_deg <= 90"
            )

    @property
    def _rad_per_px(self) -> tuple[float, float]:
        return 2 * math.pi / self.width, math.radians(self.top_deg - self.bottom_deg) / self.height

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """Return the pixel of each ego point (m); columns are in [-0.5, width-0.5]; both ends are straight behind."""
        x, y, z = points.unbind(-1)
        squared = x.square() + y.square()
        on_pole = squared == 0
        azimuth = torch.atan2(y, torch.where(on_pole, 1, x))
        radius = torch.where(on_pole, 0, torch.where(on_pole, 1, squared).sqrt())
        at_origin = on_pole & (z == 0)
        elevation = torch.atan2(torch.where(at_origin, 1, z), radius)
        step_u, step_v = self._rad_per_px
        u = (math.pi - azimuth) / step_u - 0.5
        v = (math.radians(self.top_deg) - elevation) / step_v - 0.5
        pixels = torch.stack([u.clamp(-0.5, self.width - 0.5), v], dim=-1)
        return pixels, in_image(pixels, self.width, self.height) & ~at_origin

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """Return the unit ray of each pixel, ego frame; valid in the image's rows, columns continue around the turn."""
        step_u, step_v = self._rad_per_px
        azimuth = math.pi - (pixels[..., 0] + 0.5) * step_u
        elevation = math.radians(self.top_deg) - (pixels[..., 1] + 0.5) * step_v
        flat = elevation.cos()
        rays = torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin()], dim=-1)
        valid = (pixels[..., 1] >= -0.5) & (pixels[..., 1] <= self.height - 0.5)
        return rays, valid

    def rays(self, device: torch.device | str = "cpu") -> Float32[Tensor, "height width 3"]:
        """Return the unit ray of every pixel in the ego frame; never write to the result, which is cached."""
        return _rays(self, torch.device(device))

    def resized(self, width: int, height: int) -> "Equirectangular":
        """See `Camera.resized`."""
        return replace(self, width=width, height=height)


@lru_cache(maxsize=64)
def _rays(camera: Equirectangular, device: torch.device) -> Float32[Tensor, "height width 3"]:
    with torch.inference_mode(False):  # training may use it as well
        return camera.unproject(pixel_centers(camera.width, camera.height, torch.float64, device))[0].float()
