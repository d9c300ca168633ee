"""The 2D head's classes of pixels, looked up at the voxels that see them."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.ops.deformable_attention import deformable_sum, make_level, make_table
from omniocc.model.ops.padded import crop
from omniocc.model.ops.static import is_static
from omniocc.model.ops.visible import CENTRE, every_cell, group_samples, marked_cells


def classes_at_voxels(
    pixel_logits: Float[Tensor, "B N K h w"],
    candidates: Bool[Tensor, "B X Y Z"],
    rigs: tuple[Rig, ...],
    geometry: Grid,
    stride: int,
) -> Float[Tensor, "B K X Y Z"]:
    """Return logits at the middle of every candidate: bilinear samples, their mean over the cameras that see it.

    They are zero, which prefers no class, elsewhere and where no camera sees a candidate. The logits are those of the
    classes of a map's pixels; `stride` is that of the map, px.
    """
    marked = candidates.flatten(1)
    parts, order = [], []
    for group in group_samples(rigs, marked):
        maps = crop(pixel_logits[group], rigs[group[0]], stride)
        parts.append(_at_voxels(maps, marked[group[0]], rigs[group[0]], geometry))
        order += group
    volumes = torch.cat(parts)[torch.tensor(order, device=marked.device).argsort()]
    return volumes.unflatten(1, geometry.shape).movedim(-1, 1)


def _at_voxels(
    maps: Float[Tensor, "B N K h w"], marked: Bool[Tensor, " cells"], rig: Rig, geometry: Grid
) -> Float[Tensor, "B cells K"]:
    whole = is_static()
    key = rig, geometry, marked.device, CENTRE
    cells, seen, pairs = every_cell(*key) if whole else marked_cells(marked, *key)
    height, width = maps.shape[-2:]
    with torch.autocast(maps.device.type, enabled=False):
        values = maps.to(torch.promote_types(maps.dtype, torch.float32))
        table = make_table(values.unsqueeze(2))  # of one head
        level = make_level(pairs, height, width, 1, values.dtype)
        offsets = values.new_zeros(1, 1, 2, len(seen), 1)
        sums = deformable_sum([table], offsets, offsets[:, :, 0] + 1, pairs, [level])[0] / pairs.counts[:, None]
    rows = sums.unflatten(1, (len(maps), -1)).movedim(1, 0)
    volume = rows.new_zeros(len(maps), len(marked), rows.shape[2]).index_copy(1, cells[seen], rows)
    return torch.where(marked[:, None], volume, 0) if whole else volume
