"""The output of the depth options, and their common checks and grouping."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.model.ops.depth.spheres import Spheres
from omniocc.model.ops.padded import crop, grouped, in_batch_order
from omniocc.model.ops.static import is_static


class DepthMap(NamedTuple):
    """A panorama of ranges around the ego origin.

    Attributes:
        range_m: above 0 and finite everywhere, see `Spheres.farthest_m`.
        index: fractional index of inverse range; 0 is infinity, `spheres - 1` the nearest sphere.
        valid: false where no camera sees anything, in the sky, and where the range is too uncertain.
        confidence: in [0, 1]; of a trained `SphereNet` the probability that the range is within 10 % of the true one.
    """

    range_m: Float[Tensor, "B h w"]
    index: Float[Tensor, "B h w"]
    valid: Bool[Tensor, "B h w"]
    confidence: Float[Tensor, "B h w"]

    def known_range_m(self) -> Float[Tensor, "B h w"]:
        """Return ranges, nan where they are not valid."""
        return self.range_m.float().masked_fill(~self.valid, torch.nan)


SKY_INDEX = 0.5
"""Indices below this are taken for sky: half a step from infinity."""


def from_index(
    index: Float[Tensor, "B h w"], valid: Bool[Tensor, "B h w"], confidence: Float[Tensor, "B h w"], spheres: Spheres
) -> DepthMap:
    """Return the depth map of indices, clamped to the spheres, with their ranges."""
    index = index.clamp(0, spheres.count - 1)
    return DepthMap(spheres.range_m(index), index, valid, confidence.clamp(0, 1))


def check_images(images: Float[Tensor, "B N 3 H W"], rigs: Sequence[Rig]) -> None:
    """Raise ValueError unless each sample has one rig and its images, and all values are finite.

    A rig may have fewer cameras or smaller images than the batch, which is padded (`omniocc.model.ops.padded`).
    """
    if len(rigs) != len(images):
        raise ValueError(f"{len(rigs)} rigs for {len(images)} samples; give one each")
    for rig in set(rigs):
        crop(images, rig)
    if not is_static() and not bool(images.isfinite().all()):
        raise ValueError("images hold NaN or infinity; they must be RGB in [0, 1]")


def per_rig(rigs: Sequence[Rig], run: Callable[[Rig, list[int]], DepthMap]) -> DepthMap:
    """Run samples of equal rig together and return the results in the order of samples."""
    groups = grouped(rigs)
    parts = [run(rig, samples) for rig, samples in groups.items()]
    return DepthMap(*(in_batch_order(field, groups.values()) for field in zip(*parts, strict=True)))


def weighted_sum(parts: Sequence[tuple[float, dict[str, Tensor]]]) -> dict[str, Tensor]:
    """Add losses of the same names, each part with its weight."""
    return {name: torch.stack([weight * terms[name] for weight, terms in parts]).sum() for name in parts[0][1]}
