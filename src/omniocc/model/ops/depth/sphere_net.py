"""What networks that choose among spheres share: from logits to depth, and the losses."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.model.ops.depth.depth_map import (
    SKY_INDEX,
    DepthMap,
    check_images,
    from_index,
    per_rig,
    rig_groups,
    weighted_sum,
)
from omniocc.model.ops.depth.layers import window_argmax
from omniocc.model.ops.depth.panoramic import Panoramic
from omniocc.model.ops.depth.terms import sphere_terms
from omniocc.model.ops.padded import crop


class SphereNet(Panoramic):
    """A network that gives every sphere a score in every direction, and the sky; subclasses say how, in `logits`.

    Whether there is a surface and how far it would be are two questions: the sky is no sphere, so that a doubtful edge
    against the sky does not pull the range to infinity. Where it is likelier than a surface the answer is not valid.

    Args:
        erp_size: width and height of the panorama, px.
        erp_top_deg: elevation of its upper edge.
        erp_bottom_deg: elevation of its lower edge.
        spheres: number of spheres.
        min_range_m: of the nearest sphere; None derives it from each rig.
        window: spheres to each side of the peak that make up the answer.
        min_confidence: answers below are not valid, in [0, 1].
        log_range_weight: of that term of the loss beside the index's.
        entropy_weight: likewise, of the cross-entropy over spheres.
        sky_weight: likewise, of the cross-entropy of sky or surface.
        mirror: train on the mirrored world as often as on the true one.
    """

    def __init__(
        self,
        erp_size: Sequence[int],
        erp_top_deg: float,
        erp_bottom_deg: float,
        spheres: int,
        min_range_m: float | None,
        window: int,
        min_confidence: float,
        log_range_weight: float,
        entropy_weight: float,
        sky_weight: float,
        mirror: bool,
    ):
        super().__init__(erp_size, erp_top_deg, erp_bottom_deg, spheres, min_range_m)
        self.window, self.min_confidence = window, min_confidence
        self.log_range_weight, self.entropy_weight, self.sky_weight = log_range_weight, entropy_weight, sky_weight
        self.mirror = mirror

    def logits(
        self, images: Float[Tensor, "B N 3 H W"], rig: Rig, flip: bool = False
    ) -> tuple[Float[Tensor, "B E h w"], Bool[Tensor, "B h w"]]:
        """Of every sphere and, last, of the sky, for samples of one rig, and whether any camera sees the direction.

        Mirrored if asked: images and panoramas go through the networks flipped, while the sweep between them stays, as
        with a mirrored rig in a mirrored world.
        """
        raise NotImplementedError

    def forward(
        self,
        images: Float[Tensor, "B N 3 H W"],
        rigs: tuple[Rig, ...],
        true_range_m: Float[Tensor, "B h w"] | None = None,
    ) -> DepthMap:
        """Depth from RGB in [0, 1]; the true range is not looked at.

        Raises:
            ValueError: if images and rigs do not fit together, or images hold NaN.
        """
        check_images(images, rigs)

        def one(rig: Rig, samples: list[int]) -> DepthMap:
            logits, seen = self.logits(crop(images[samples], rig), rig)
            index, mass = window_argmax(logits[:, :-1], self.window)
            solid = (-logits[:, -1].float()).sigmoid()
            confidence = mass * solid
            valid = seen & (solid > 0.5) & (index >= SKY_INDEX) & (confidence >= self.min_confidence)
            return from_index(index, valid, confidence, self.rig_spheres(rig))

        return per_rig(rigs, one)

    def training_terms(
        self,
        images: Float[Tensor, "B N 3 H W"],
        rigs: tuple[Rig, ...],
        erp_range_m: Float[Tensor, "B h w"],
        camera_range_m: Float[Tensor, "B N H W"] | None,
        generator: torch.Generator,
    ) -> dict[str, Float[Tensor, ""]]:
        """Losses `index`, `log_range`, `spheres` and `sky`, see `sphere_terms`, from the panorama alone.

        Args:
            images: RGB in [0, 1].
            rigs: one per sample.
            erp_range_m: true panorama; inf for the sky, nan does not count.
            camera_range_m: is not looked at.
            generator: decides whether this batch is mirrored, on the CPU.

        Raises:
            ValueError: if images and rigs do not fit together, or images hold NaN.
        """
        check_images(images, rigs)
        flip = self.mirror and bool(torch.rand((), generator=generator) < 0.5)
        target_m = erp_range_m.flip(-1) if flip else erp_range_m
        parts = []
        for rig, samples in rig_groups(rigs):
            logits, _ = self.logits(crop(images[samples], rig), rig, flip)
            index, _ = window_argmax(logits[:, :-1], self.window)
            weights = self.log_range_weight, self.entropy_weight, self.sky_weight
            terms = sphere_terms(logits, index, target_m[samples], self.rig_spheres(rig), *weights)
            parts.append((len(samples) / len(images), terms))
        return weighted_sum(parts)
