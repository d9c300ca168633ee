"""Lift, splat: image features spread along their rays by a predicted distribution of range (BEVDet)."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Float64, Int32, Int64
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from omniocc.bounds import Size
from omniocc.camera import Rig
from omniocc.camera.ops.pixels import usable
from omniocc.geometry import Grid
from omniocc.model.ops.multilinear import bag_sum, inner_products
from omniocc.model.ops.padded import FeatureMaps, crop, frame_size, shape_groups
from omniocc.model.ops.rig_cache import once_per_rig
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
        channels: of the volume.
        levels: strides of the feature maps, px, finest first.
        bins: of range, of equal size.
        range_m: beginning of the first bin and end of the last one, along the ray.

    Raises:
        ValueError: if there is no bin, or the ranges do not increase from zero on.
    """

    def __init__(
        self, geometry: Grid, in_channels: Size, channels: Size, levels: list[int], bins: Size, range_m: Interval
    ):
        super().__init__()
        if bins < 1:
            raise ValueError(f"bins is {bins}; at least one is needed")
        if len(range_m) != 2 or not 0 <= range_m[0] < range_m[1]:
            raise ValueError(f"range_m is {list(range_m)}; it must be two increasing distances in metres, from 0 on")
        self.geometry = geometry
        self.channels, self.strides, self.reach_m = channels, list(levels), float(range_m[1])
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


class Entries(NamedTuple):
    """All pairs (pixel, bin) of a rig whose point is in the grid, in order of pixels and in order of voxels.

    Attributes:
        slot: index of each entry among all pixels x bins.
        voxel: of each entry.
        pixel_ends: number of entries before each pixel's first, and at the end the number of all.
        by_voxel: the entries sorted by voxel, and by pixel within one.
        pixel: of the sorted entries.
        voxel_first: index of each voxel's first sorted entry.
    """

    slot: Int64[Tensor, " E"]
    voxel: Int32[Tensor, " E"]
    pixel_ends: Int32[Tensor, " ends"]
    by_voxel: Int64[Tensor, " E"]
    pixel: Int32[Tensor, " E"]
    voxel_first: Int32[Tensor, " cells"]


def bin_points(
    rig: Rig, height: int, width: int, ranges_m: Float64[Tensor, " D"]
) -> tuple[Float64[Tensor, "P D 3"], Bool[Tensor, " P"]]:
    """Return points at these ranges on the rays through the pixels of feature maps, and whether the pixel is valid.

    The maps (height x width px) span the rig's largest image. Points are in the ego frame, m, by camera, row, column.
    """
    points, seen = [], []
    frame = frame_size(rig)
    scale = torch.tensor([frame[0] / width, frame[1] / height], dtype=torch.float64)
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = (torch.stack([columns, rows], dim=-1).reshape(-1, 2) + 0.5) * scale - 0.5
    for index, camera in enumerate(rig.cameras):
        rays, valid = camera.unproject(pixels)
        valid = valid & (pixels < torch.tensor([camera.width, camera.height]) - 0.5).all(-1)
        pose = rig.ego_from_camera[index]
        directions = torch.where(valid[:, None], rays, 0.0) @ pose[:3, :3].T
        points.append(pose[:3, 3] + directions[:, None] * ranges_m[:, None])
        seen.append(usable(rig.each_mask[index], pixels, valid))
    return torch.cat(points), torch.cat(seen)


@once_per_rig
def find_entries(
    rig: Rig, geometry: Grid, height: int, width: int, ranges_m: tuple[float, ...], device: torch.device
) -> Entries:
    """Return the entries of a rig and a grid; never write to the result, which is cached."""
    points_m, seen = bin_points(rig, height, width, torch.tensor(ranges_m, dtype=torch.float64))
    cells, inside = geometry.flat_index(points_m)
    inside &= seen[:, None]
    slot = inside.flatten().nonzero()[:, 0]
    voxel = cells.flatten()[slot]
    order = voxel.argsort(stable=True)
    counts = torch.bincount(voxel, minlength=geometry.num_cells)
    pixel = torch.div(slot, len(ranges_m), rounding_mode="floor")
    ends = F.pad(inside.sum(1).cumsum(0), (1, 0))
    parts = (slot, voxel.int(), ends.int(), order, pixel[order].int(), (counts.cumsum(0) - counts).int())
    return Entries(*(part.to(device) for part in parts))


class _Splat(torch.autograd.Function):
    """Implement `splat` without storing the outer product or its gradient."""

    @staticmethod
    def forward(ctx: Any, context: Tensor, probability: Tensor, entries: Entries) -> Tensor:
        ctx.save_for_backward(context, probability)
        ctx.entries = entries
        weights = probability.flatten().index_select(0, entries.slot).index_select(0, entries.by_voxel)
        return bag_sum(entries.pixel, context, entries.voxel_first, weights)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Any:
        context, probability = ctx.saved_tensors
        entries: Entries = ctx.entries
        grad = grad.contiguous()
        weights = probability.flatten().index_select(0, entries.slot)
        first = entries.pixel_ends[:-1]
        grad_context = bag_sum(entries.voxel, grad, first, weights)
        products = inner_products(context, grad, entries.pixel_ends, entries.voxel)
        grad_probability = torch.zeros_like(probability).flatten().index_copy_(0, entries.slot, products)
        return grad_context, grad_probability.view_as(probability), None


def splat(
    context: Float[Tensor, "P C"], probability: Float[Tensor, "P D"], entries: Entries
) -> Float[Tensor, "cells C"]:
    """Add each pixel's feature to the voxel of each of its bins, times the bin's probability.

    This sums the outer products of features and probabilities (Philion & Fidler, 2020) without storing them. Bins
    outside the grid are ignored. Differentiable once.
    """
    return _Splat.apply(context, probability, entries)  # type: ignore[return-value]
