"""Base of the depth options: samples of equal rig are computed together, without padding."""

from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from omniocc.camera import Equirectangular, Rig
from omniocc.model.ops.depth.depth_map import DepthMap, check_images, per_rig, weighted_sum
from omniocc.model.ops.depth.spheres import SphereRange, Spheres
from omniocc.model.ops.padded import Images, Rigs, crop, shape_groups, to_unit_range


class PanoramaDepth(nn.Module):
    """Estimate ranges from images; subclasses implement `estimate` for samples of one rig.

    Args:
        panorama: directions of the ranges.
        spheres: number and reach of the spheres to which indices refer.
    """

    NEEDS_TRUE_RANGE: ClassVar[bool] = False
    COMPARES_CAMERAS: ClassVar[bool] = False

    def __init__(self, panorama: Equirectangular, spheres: SphereRange):
        super().__init__()
        self.panorama, self.spheres = panorama, spheres

    def rig_spheres(self, rig: Rig) -> Spheres:
        """Return the spheres to which the indices refer for a rig."""
        return self.spheres.of(rig, self.panorama)

    def estimate(self, images: Float[Tensor, "B N 3 H W"], rig: Rig) -> DepthMap:
        """Return depth from RGB in [0, 1], for samples of one rig without padding."""
        raise NotImplementedError

    def forward(self, images: Images, rigs: Rigs, true_range_m: Float[Tensor, "B h w"] | None = None) -> DepthMap:
        """Return depth from RGB; the true range is ignored.

        Raises:
            ValueError: if images and rigs do not fit together, or images hold NaN.
        """
        images = to_unit_range(images)
        check_images(images, rigs)
        one = len(set(rigs)) == 1
        return per_rig(rigs, lambda rig, own: self.estimate(crop(images if one else images[own], rig), rig))


class DepthBatch(NamedTuple):
    """Samples that a depth network learns from, as in `LearnedDepth.weighted_losses`, but without padding."""

    images: Float[Tensor, "B N 3 H W"]
    rigs: Rigs
    erp_range_m: Float[Tensor, "B h w"]
    camera_range_m: Float[Tensor, "B N H W"] | None


class LearnedPanoramaDepth(PanoramaDepth):
    """Learn to estimate ranges; subclasses implement `losses` for samples whose images have one shape.

    Other arguments as in `PanoramaDepth`.

    Args:
        mirror: train on the mirrored world as often as on the true one.
    """

    NEEDS_CAMERA_RANGES: ClassVar[bool] = True

    def __init__(self, panorama: Equirectangular, spheres: SphereRange, mirror: bool):
        super().__init__(panorama, spheres)
        self.mirror = mirror

    def losses(self, batch: DepthBatch, flip: bool) -> dict[str, Float[Tensor, ""]]:
        """Return weighted losses by name of samples whose images have one shape.

        With `flip` it is the mirrored world that is learned: the true ranges are mirrored, the images are not yet.
        """
        raise NotImplementedError

    def weighted_losses(
        self,
        images: Float[Tensor, "B N 3 H W"],
        rigs: Rigs,
        erp_range_m: Float[Tensor, "B h w"],
        camera_range_m: Float[Tensor, "B N H W"] | None,
        generator: torch.Generator,
    ) -> dict[str, Float[Tensor, ""]]:
        """Return weighted losses by name, see `LearnedDepth`.

        Raises:
            ValueError: if images and rigs do not fit together, or images hold NaN.
        """
        check_images(images, rigs)
        flip = self.mirror and bool(torch.rand((), generator=generator) < 0.5)
        parts = []
        for samples in shape_groups(rigs):
            same = tuple(rigs[sample] for sample in samples)
            erp_m, camera_m = erp_range_m[samples], None
            if camera_range_m is not None:
                camera_m = crop(camera_range_m[samples], same[0])
            if flip:
                erp_m, camera_m = erp_m.flip(-1), None if camera_m is None else camera_m.flip(-1)
            terms = self.losses(DepthBatch(crop(images[samples], same[0]), same, erp_m, camera_m), flip)
            parts.append((len(samples) / len(images), terms))
        return weighted_sum(parts)
