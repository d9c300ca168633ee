"""Maps of the cameras, looked up at the voxels that they see."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from omniocc.camera import Rig
from omniocc.geometry import Grid
from omniocc.model.ops.deformable_attention import centres_of_every_cell, deformable_sum, make_level, make_table
from omniocc.model.ops.multilinear import bag_sum
from omniocc.model.ops.padded import crop, in_batch_order
from omniocc.model.ops.static import is_static
from omniocc.model.ops.visible import CENTRE, every_cell, group_samples, marked_cells


def sample_at_voxels(
    maps: Float[Tensor, "B N C h w"],
    candidates: Bool[Tensor, "B X Y Z"],
    rigs: tuple[Rig, ...],
    geometry: Grid,
    stride: int,
) -> Float[Tensor, "B C X Y Z"]:
    """Return values at the middle of every candidate: bilinear samples, their mean over the cameras that see it.

    They are zero elsewhere and where no camera sees a candidate. `stride` is that of the maps, px.
    """
    marked = candidates.flatten(1)
    groups, parts = group_samples(rigs, marked), []
    for group in groups:
        own = crop(maps if len(groups) == 1 else maps[group], rigs[group[0]], stride)
        parts.append(_at_voxels(own, marked[group[0]], rigs[group[0]], geometry))
    return in_batch_order(parts, groups).unflatten(1, geometry.shape).movedim(-1, 1)


def _at_voxels(
    maps: Float[Tensor, "B N C h w"], marked: Bool[Tensor, " cells"], rig: Rig, geometry: Grid
) -> Float[Tensor, "B cells C"]:
    whole = is_static()
    key = rig, geometry, marked.device, CENTRE
    cells, seen, pairs = every_cell(*key) if whole else marked_cells(marked, *key)
    height, width = maps.shape[-2:]
    with torch.autocast(maps.device.type, enabled=False):
        values = maps.to(torch.promote_types(maps.dtype, torch.float32))
        table = make_table(values.unsqueeze(2))  # of one head
        if whole:
            entries = centres_of_every_cell(*key[:3], height, width, values.dtype)
            total = bag_sum(entries[0], table[0], entries[2], entries[1]).view(4, len(seen), -1).sum(0)
        else:
            level = make_level(pairs, height, width, 1, 1, values.dtype)
            offsets = values.new_zeros(1, 1, 2, len(seen), 1)
            total = deformable_sum([table], offsets, offsets[:, :, 0] + 1, [level])[0]
        sums = total / pairs.counts[:, None]
    rows = sums.unflatten(1, (len(maps), -1)).movedim(1, 0)
    volume = rows.new_zeros(len(maps), len(marked), rows.shape[2]).index_copy(1, seen if whole else cells[seen], rows)
    return torch.where(marked[:, None], volume, 0) if whole else volume
