"""Lift, splat: image features spread along their rays by a predicted distribution of range (BEVDet)."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.ops.lifter.splat import find_entries, splat
from omniocc.model.ops.padded import FeatureMaps, crop, shape_groups
from omniocc.model.protocols import Sketched

Interval = Sequence[float | int]


class LiftSplat(nn.Module):
    """Spread each pixel's feature over bins of range by predicted probabilities, and sum what falls into each voxel.

    Philion & Fidler (2020, 'Lift, Splat, Shoot') as in the occupancy version of BEVDet (Huang et al., 2021), but along
    each camera's own unit rays: bins are distances from the camera, not depths along its axis, so that a fisheye lens
    works past 90 degrees. All voxels are filled; candidates are ignored. Of several feature maps the finer ones are
    averaged down to the coarsest and added.

    Args:
        in_channels: of image features.
        levels: strides of the feature maps, px, finest first.
        bins: of range, of equal size.
        range_m: beginning of the first bin and end of the last one, along the ray.

    Raises:
        ValueError: if there is no bin, or the ranges do not increase from zero on.
    """

    def __init__(
        self, geometry: Grid, in_channels: int, channels: int, levels: list[int], bins: int, range_m: Interval
    ):
        super().__init__()
        if bins < 1:
            raise ValueError(f"bins is {bins}; at least one is needed")
        if len(range_m) != 2 or not 0 <= range_m[0] < range_m[1]:
            raise ValueError(f"range_m is {list(range_m)}; it must be two increasing distances in metres, from 0 on")
        self.geometry = geometry
        self.channels, self.strides = channels, list(levels)
        step_m = (range_m[1] - range_m[0]) / bins
        self.ranges_m = tuple(range_m[0] + (index + 0.5) * step_m for index in range(bins))
        self.split = nn.Linear(in_channels, bins + channels)

    def forward(self, features: FeatureMaps, sketched: Sketched, rigs: tuple[Rig, ...]) -> Float[Tensor, "B D X Y Z"]:
        """Lift and splat each sample through its own rig."""
        groups = shape_groups(rigs)
        volumes: list[Tensor] = [features[0]] * len(rigs)
        for samples in groups:
            levels = [level if len(groups) == 1 else level[samples] for level in features]
            maps = [crop(level, rigs[samples[0]], stride) for level, stride in zip(levels, self.strides, strict=True)]
            for sample, volume in zip(samples, self._splat(maps, [rigs[k] for k in samples]), strict=True):
                volumes[sample] = volume
        # channels last in memory, which is fast in 3D convolutions
        return torch.stack(volumes).unflatten(1, self.geometry.shape).movedim(-1, 1)

    def _splat(self, features: FeatureMaps, rigs: list[Rig]) -> list[Float[Tensor, "cells D"]]:
        """Return the volumes of samples whose images have one shape."""
        height, width = features[-1].shape[-2:]
        pixels = self._pixels(features).flatten(1, 3)
        with torch.autocast(pixels.device.type, enabled=False):
            scores, context = self.split(pixels).split([len(self.ranges_m), self.channels], dim=-1)
            fractions = scores.softmax(-1)
            entries = (find_entries(rig, self.geometry, height, width, self.ranges_m, pixels.device) for rig in rigs)
            parts = zip(context, fractions, entries, strict=True)
            return [splat(values.contiguous(), fraction, entry) for values, fraction, entry in parts]

    def range_logits(self, features: FeatureMaps) -> Float[Tensor, "B N D h w"]:
        """Return scores of the bins, which a loss may compare with true ranges (`omniocc.loss.RangeBins`)."""
        pixels, bins = self._pixels(features), len(self.ranges_m)
        with torch.autocast(pixels.device.type, enabled=False):
            return F.linear(pixels, self.split.weight[:bins], self.split.bias[:bins]).movedim(-1, 2)

    def _pixels(self, features: FeatureMaps) -> Float[Tensor, "B N h w C"]:
        """Return the sum of all maps at the size of the coarsest, in float32 at least."""
        size, coarsest = tuple(features[-1].shape[-2:]), features[-1].flatten(0, 1)
        maps = sum((F.adaptive_avg_pool2d(level.flatten(0, 1), size) for level in features[:-1]), 0)  # type: ignore[arg-type]
        pixels = (maps + coarsest).unflatten(0, features[-1].shape[:2]).movedim(2, -1)
        return pixels.to(torch.promote_types(pixels.dtype, torch.float32))
