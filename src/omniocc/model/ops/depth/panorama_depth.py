"""Base of the depth options: samples of equal rig go through together, without padding."""

from typing import ClassVar

from jaxtyping import Float
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.model.ops.depth.depth_map import DepthMap, check_images, per_rig
from omniocc.model.ops.depth.spheres import SphereRange, Spheres
from omniocc.model.ops.padded import crop


class PanoramaDepth(nn.Module):
    """Estimate ranges from images; subclasses do so for samples of one rig, in `estimate`.

    Args:
        panorama: directions of the answer.
        spheres: number and reach of the spheres, in whose indices the range is also given.
    """

    NEEDS_TRUE_RANGE: ClassVar[bool] = False

    def __init__(self, panorama: Equirectangular, spheres: SphereRange):
        super().__init__()
        self.panorama, self.spheres = panorama, spheres

    def rig_spheres(self, rig: Rig) -> Spheres:
        """Return the spheres in whose indices it answers for a rig."""
        return self.spheres.of(rig, self.panorama)

    def estimate(self, images: Float[Tensor, "B N 3 H W"], rig: Rig) -> DepthMap:
        """Return depth from RGB in [0, 1], for samples of one rig without padding."""
        raise NotImplementedError

    def forward(
        self,
        images: Float[Tensor, "B N 3 H W"],
        rigs: tuple[Rig, ...],
        true_range_m: Float[Tensor, "B h w"] | None = None,
    ) -> DepthMap:
        """Return depth from RGB in [0, 1]; the true range is ignored.

        Raises:
            ValueError: if images and rigs do not fit together, or images hold NaN.
        """
        check_images(images, rigs)
        return per_rig(rigs, lambda rig, samples: self.estimate(crop(images[samples], rig), rig))
