import pytest
import torch
from torch.nn import functional as F

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.refiner import Conv
from omniocc.model.refiner.conv import block as make_block
from omniocc.model.sketch import Sketched

SKETCHED = Sketched(torch.ones(1, 1, 1, 1, dtype=torch.bool))

CYLINDER, CUBOID = Cylinder((6, 8, 4)), Cuboid((5, 6, 3))


def convolve(volume, weight, periodic):
    """3x3x3 convolution of one sample by shifts: (D, X, Y, Z) of (C, X, Y, Z)."""
    total = 0
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            for dz in (-1, 0, 1):
                moved = volume
                for axis, step in enumerate((dx, dy, dz), start=1):
                    moved = moved.roll(-step, axis)
                    if step and not periodic[axis - 1]:
                        moved = moved.clone().index_fill_(
                            axis, torch.tensor(moved.shape[axis] - 1 if step > 0 else 0), 0
                        )
                total = total + torch.einsum("dc,cxyz->dxyz", weight[:, :, dx + 1, dy + 1, dz + 1], moved)
    return total


def normalize(volume, norm):
    """Group norm of one sample by hand."""
    groups = volume.reshape(norm.num_groups, -1)
    spread = groups.var(1, correction=0, keepdim=True)
    unit = ((groups - groups.mean(1, keepdim=True)) / (spread + norm.eps).sqrt()).view(volume.shape)
    return unit * norm.weight[:, None, None, None] + norm.bias[:, None, None, None]


@torch.no_grad()
@pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])
def test_a_block_equals_its_formula(geometry):
    block = make_block(8, geometry.periodic).double()
    for norm in (block.first_norm, block.second_norm):
        torch.nn.init.normal_(norm.weight)
        torch.nn.init.normal_(norm.bias)
    volume = torch.randn(8, *geometry.shape, dtype=torch.float64)
    hidden = normalize(convolve(volume, block.first.weight, geometry.periodic), block.first_norm).clamp(min=0)
    change = normalize(convolve(hidden, block.second.weight, geometry.periodic), block.second_norm)
    torch.testing.assert_close(block(volume[None])[0], (volume + change).clamp(min=0))


@torch.no_grad()
def test_levels_are_merged_as_if_laid_side_by_side_and_mixed():
    refiner = Conv(Cuboid((8, 8, 4)), 4, [8, 16], [1, 1]).double()
    volume = torch.randn(2, 4, 8, 8, 4, dtype=torch.float64)
    fine = refiner.stages[0](refiner.stem(volume))
    coarse = refiner.stages[1](refiner.down[0](fine))
    wide = torch.cat([fine, F.interpolate(coarse, scale_factor=2, mode="trilinear")], dim=1)
    weight = torch.cat([merge.weight for merge in refiner.merge], dim=1)
    bias = refiner.merge[0].bias + refiner.merge[1].bias
    mixed = torch.einsum("dc,bcxyz->bdxyz", weight, wide) + bias[:, None, None, None]
    torch.testing.assert_close(refiner(volume, SKETCHED), refiner.norm(mixed).clamp(min=0))
