"""Sums of pixel features over the voxels along their rays, weighted by the probability of the surface."""

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Float64, Int32, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.ops.multilinear import bag_sum, inner_products
from omniocc.model.ops.padded import frame_size
from omniocc.model.ops.rig_cache import once_per_rig


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
        mask = None if rig.masks is None else rig.masks[index]
        if mask is not None:
            nearest = pixels.round().long()
            u, v = nearest[:, 0].clamp(0, camera.width - 1), nearest[:, 1].clamp(0, camera.height - 1)
            valid = valid & mask[v, u]
        seen.append(valid)
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
