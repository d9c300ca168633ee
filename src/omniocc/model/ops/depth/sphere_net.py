"""Base of the networks that choose among spheres: from logits to depth, and the losses."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.bounds import Weight
from omniocc.camera import Equirectangular, Rig
from omniocc.model.ops.depth.confidence import Confidence
from omniocc.model.ops.depth.depth_map import SKY_INDEX, DepthMap, from_index, weighted_sum
from omniocc.model.ops.depth.layers import window_argmax
from omniocc.model.ops.depth.panorama_depth import DepthBatch, LearnedPanoramaDepth
from omniocc.model.ops.depth.projection import Present, present_cameras
from omniocc.model.ops.depth.spheres import SphereRange, Spheres
from omniocc.model.ops.padded import grouped


def two_hot_cross_entropy(logits: Float[Tensor, "B D h w"], index: Float[Tensor, "B h w"]) -> Float[Tensor, "B h w"]:
    """Return the cross-entropy with the two spheres beside `index`, weighted so that their mean is `index`."""
    log_p = logits.float().log_softmax(1)
    lower = index.floor().clamp(max=logits.shape[1] - 2)
    fraction = index - lower
    spheres = torch.stack([lower, lower + 1], 1).long()
    near = log_p.gather(1, spheres)
    return -((1 - fraction) * near[:, 0] + fraction * near[:, 1])


def _mean(values: Float[Tensor, "B h w"], counted: Bool[Tensor, "B h w"]) -> Float[Tensor, ""]:
    return torch.where(counted, values, 0).sum() / counted.sum().clamp(min=1)


@dataclass(frozen=True)
class SphereLoss:
    """Compute losses of index, log range and spheres where there is a surface, and of sky against surface.

    Smooth L1 of the index (weight 1) and of the log of the range, and cross-entropy over spheres, are means over pixels
    nearer than `SKY_INDEX`; the cross-entropy of sky or surface is a mean over all known pixels.
    """

    log_range_weight: Weight
    entropy_weight: Weight
    sky_weight: Weight

    def __call__(
        self,
        logits: Float[Tensor, "B D h w"],
        index: Float[Tensor, "B h w"],
        true_range_m: Float[Tensor, "B h w"],
        spheres: Spheres,
    ) -> dict[str, Float[Tensor, ""]]:
        """Return the losses `index`, `log_range`, `spheres` and `sky`.

        Args:
            logits: of the spheres and, last, of the sky.
            index: predicted.
            true_range_m: inf for the sky; nan does not count.
            spheres: meaning of the indices.
        """
        known = ~true_range_m.isnan()
        true = spheres.index(torch.where(known, true_range_m, torch.inf)).clamp(max=spheres.count - 1)
        near = known & (true > SKY_INDEX)
        sky = F.binary_cross_entropy_with_logits(logits[:, -1].float(), (~near).float(), reduction="none")
        ratio = (index.clamp(min=SKY_INDEX) / true.clamp(min=SKY_INDEX)).log()
        log_range = F.smooth_l1_loss(ratio, 0 * ratio, beta=0.05, reduction="none")
        return {
            "index": _mean(F.smooth_l1_loss(index, true, reduction="none"), near),
            "log_range": self.log_range_weight * _mean(log_range, near),
            "spheres": self.entropy_weight * _mean(two_hot_cross_entropy(logits[:, :-1], true), near),
            "sky": self.sky_weight * _mean(sky, known),
        }


class SphereNet(LearnedPanoramaDepth):
    """Score every sphere and the sky in every direction; subclasses implement `features`, `sweep` and `scores`.

    The sky is no sphere, so that an uncertain edge against it does not pull the range to infinity. Where the sky is
    more likely than a surface, the range is not valid. Other arguments as in `LearnedPanoramaDepth`.

    Args:
        loss: of scores and index against the true panorama.
        window: spheres to each side of the peak over which the index is averaged.
        min_confidence: ranges that are less likely than this to be within 10 % are not valid, in [0, 1].
    """

    COMPARES_CAMERAS: ClassVar[bool] = True
    NEEDS_CAMERA_RANGES: ClassVar[bool] = False
    features: nn.Module

    def __init__(
        self,
        panorama: Equirectangular,
        spheres: SphereRange,
        loss: SphereLoss,
        window: int,
        min_confidence: float,
        mirror: bool,
    ):
        super().__init__(panorama, spheres, mirror)
        self.loss, self.window, self.min_confidence = loss, window, min_confidence
        self.confidence = Confidence()

    def logits(
        self, images: Float[Tensor, "B N 3 H W"], rig: Rig, flip: bool = False
    ) -> tuple[Float[Tensor, "B E h w"], Bool[Tensor, "B h w"]]:
        """Return scores of every sphere and, last, of the sky, and whether any camera sees the direction.

        Args:
            images: of samples of one rig, without padding.
            rig: their cameras.
            flip: whether images and panoramas are mirrored for the networks, but not for the sweep between them; this
                is equal to a mirrored rig in a mirrored world.
        """
        features = self.features(images.flip(-1) if flip else images)
        swept, seen = self.sweep(features.flip(-1) if flip else features, Present.of(present_cameras(images)), rig)
        logits = self.scores(swept.flip(-1) if flip else swept)
        seen = seen.flip(-1) if flip else seen
        return logits, F.interpolate(seen.float(), logits.shape[-2:])[:, 0] > 0

    def sweep(
        self, features: Float[Tensor, "B N C _ _"], present: Present, rig: Rig
    ) -> tuple[Float[Tensor, "B E *D h w"], Bool[Tensor, "B 1 h w"]]:
        """Return what the features of all cameras give on the spheres, and the mask of directions that any one sees."""
        raise NotImplementedError

    def scores(self, swept: Float[Tensor, "B C *D _ _"]) -> Float[Tensor, "B E h w"]:
        """Return scores of every sphere and, last, of the sky, at the size of the panorama."""
        raise NotImplementedError

    def estimate(self, images: Float[Tensor, "B N 3 H W"], rig: Rig) -> DepthMap:
        """Return depth from RGB in [0, 1], for samples of one rig without padding."""
        logits, seen = self.logits(images, rig)
        index, mass = window_argmax(logits[:, :-1], self.window)
        solid = (-logits[:, -1].float()).sigmoid()
        spheres = self.rig_spheres(rig)
        confidence = self.confidence(mass * solid, spheres.range_m(index))
        valid = seen & (solid > 0.5) & (index >= SKY_INDEX) & (confidence >= self.min_confidence)
        return from_index(index, valid, confidence, spheres)

    def calibrate(
        self, confidence: Float[Tensor, " N"], range_m: Float[Tensor, " N"], right: Bool[Tensor, " N"]
    ) -> None:
        """Fit the confidence to rays whose truth is known, see `Calibrates`."""
        self.confidence.fit(confidence, range_m, right)

    def losses(self, batch: DepthBatch, flip: bool) -> dict[str, Float[Tensor, ""]]:
        """Return the losses of `SphereLoss`, which use only the panorama."""
        parts = []
        for rig, samples in grouped(batch.rigs).items():
            logits, _ = self.logits(batch.images[samples], rig, flip)
            index, _ = window_argmax(logits[:, :-1], self.window)
            terms = self.loss(logits, index, batch.erp_range_m[samples], self.rig_spheres(rig))
            parts.append((len(samples) / len(batch.images), terms))
        return weighted_sum(parts)
