"""The common part of camera models with one focal length per image axis."""

from dataclasses import dataclass, replace

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.ops.pixels import in_image
from omniocc.camera.protocol import check_fields, pair, positive_pair, scaled_center


@dataclass(frozen=True)
class FocalCamera:
    """An image with a focal length per axis; subclasses map points to its normalised plane (`_to_plane`) and back.

    Both functions also return what the model covers.

    Attributes:
        width: of the image, px.
        height: of the image, px.
        focal_px: (fx, fy), pixels per unit of the normalised plane.
        center_px: (cx, cy), the pixel of the optical axis.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    center_px: tuple[float, float]

    def __post_init__(self) -> None:
        check_fields(self, {"focal_px": positive_pair, "center_px": pair})

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        plane, covered = self._to_plane(points)
        pixels = plane * plane.new_tensor(self.focal_px) + plane.new_tensor(self.center_px)
        return pixels, covered & in_image(pixels, self.width, self.height)

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        return self._from_plane((pixels - pixels.new_tensor(self.center_px)) / pixels.new_tensor(self.focal_px))

    def resized(self, width: int, height: int) -> "FocalCamera":
        """See `Camera.resized`."""
        scale_x, scale_y = width / self.width, height / self.height
        focal_px = (self.focal_px[0] * scale_x, self.focal_px[1] * scale_y)
        center_px = scaled_center(self.center_px, scale_x, scale_y)
        return replace(self, width=width, height=height, focal_px=focal_px, center_px=center_px)

    def _to_plane(self, points: Float[Tensor, "*batch 3"]) -> tuple[Tensor, Tensor]:
        raise NotImplementedError

    def _from_plane(self, plane: Float[Tensor, "*batch 2"]) -> tuple[Tensor, Tensor]:
        raise NotImplementedError
