"""A camera whose images are equirectangular panoramas around the camera."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.models.equirectangular import Equirectangular
from omniocc.camera.protocol import check_fields, finite


@dataclass(frozen=True)
class Panoramic:
    """Camera that sees all around: columns are azimuths over the full turn, rows elevations.

    `Equirectangular` has the same columns and rows, but its points are in the ego frame (x forward, y left, z up). The
    points here are in a camera frame (x right, y down, z forward). The middle column looks forward; the first and the
    last column meet behind the camera.

    Attributes:
        width: image width, px.
        height: image height, px.
        top_deg: elevation of the image's upper edge, degrees; positive angles are above the camera.
        bottom_deg: elevation of the image's lower edge, degrees.
    """

    width: int
    height: int
    top_deg: float
    bottom_deg: float

    def __post_init__(self) -> None:
        check_fields(self, {"top_deg": finite, "bottom_deg": finite})
        _ = self._panorama  # its constructor checks that bottom_deg < top_deg, both within 90 degrees

    @property
    def _panorama(self) -> Equirectangular:
        return Equirectangular(self.width, self.height, self.top_deg, self.bottom_deg)

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        right, down, forward = points.unbind(-1)
        return self._panorama.project(torch.stack([forward, -right, -down], dim=-1))

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        rays, valid = self._panorama.unproject(pixels)
        forward, left, up = rays.unbind(-1)
        return torch.stack([-left, -up, forward], dim=-1), valid

    def resized(self, width: int, height: int) -> "Panoramic":
        """See `Camera.resized`."""
        return replace(self, width=width, height=height)
