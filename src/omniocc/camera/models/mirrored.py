"""A camera whose image is flipped left to right."""

from dataclasses import dataclass, replace

from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera.protocol import Camera


@dataclass(frozen=True)
class Mirrored:
    """Camera with the flipped images of `camera`: exact for every model, tangential distortion included.

    Attributes:
        camera: the camera whose images are flipped, column u to width - 1 - u.
    """

    camera: Camera

    @property
    def width(self) -> int:
        """Return the pixels in a row."""
        return self.camera.width

    @property
    def height(self) -> int:
        """Return the pixels in a column."""
        return self.camera.height

    def project(self, points: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 2"], Bool[Tensor, "*batch"]]:
        """See `Camera.project`."""
        pixels, valid = self.camera.project(points * points.new_tensor([-1.0, 1.0, 1.0]))
        return self._flip(pixels), valid

    def unproject(self, pixels: Float[Tensor, "*batch 2"]) -> tuple[Float[Tensor, "*batch 3"], Bool[Tensor, "*batch"]]:
        """See `Camera.unproject`."""
        rays, valid = self.camera.unproject(self._flip(pixels))
        return rays * rays.new_tensor([-1.0, 1.0, 1.0]), valid

    def resized(self, width: int, height: int) -> "Mirrored":
        """See `Camera.resized`."""
        return replace(self, camera=self.camera.resized(width, height))

    def _flip(self, pixels: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        return pixels * pixels.new_tensor([-1.0, 1.0]) + pixels.new_tensor([self.width - 1.0, 0.0])


def mirrored(camera: Camera) -> Camera:
    """Return the camera with the flipped images of `camera`; of a mirrored camera, the original one."""
    return camera.camera if isinstance(camera, Mirrored) else Mirrored(camera)
