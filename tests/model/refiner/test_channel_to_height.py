import pytest
import torch
from torch.nn import functional as F

from omniocc.extras.rivals import ChannelToHeight
from omniocc.extras.rivals.channel_to_height import view_block
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.sketch import Sketched

SKETCHED = Sketched(torch.ones(1, 1, 1, 1, dtype=torch.bool))

CYLINDER, CUBOID = Cylinder((6, 8, 3)), Cuboid((5, 6, 3))
GRIDS = pytest.mark.parametrize("geometry", [CYLINDER, CUBOID], ids=["cylinder", "cuboid"])


def convolve(view, weight, periodic):
    """3x3 convolution of one sample by loops over cells: (D, X, Y) of (C, X, Y)."""
    _, x_cells, y_cells = view.shape
    total = torch.zeros(len(weight), x_cells, y_cells, dtype=view.dtype)
    for x in range(x_cells):
        for y in range(y_cells):
            for dx in (-1, 0, 1):
                for dy in (-1, 0, 1):
                    i, j = x + dx, (y + dy) % y_cells if periodic[1] else y + dy
                    if 0 <= i < x_cells and 0 <= j < y_cells:
                        total[:, x, y] += weight[:, :, dx + 1, dy + 1] @ view[:, i, j]
    return total


def normalize(view, norm):
    """Group norm of one sample by hand; one group."""
    assert norm.num_groups == 1
    unit = (view - view.mean()) / (view.var(correction=0) + norm.eps).sqrt()
    return unit * norm.weight[:, None, None] + norm.bias[:, None, None]


@torch.no_grad()
@GRIDS
def test_a_block_equals_its_formula(geometry):
    block = view_block(8, geometry.periodic).double()
    for norm in (block.first_norm, block.second_norm):
        torch.nn.init.normal_(norm.weight)
        torch.nn.init.normal_(norm.bias)
    view = torch.randn(8, *geometry.shape[:2], dtype=torch.float64)
    hidden = normalize(convolve(view, block.first.weight, geometry.periodic), block.first_norm).clamp(min=0)
    change = normalize(convolve(hidden, block.second.weight, geometry.periodic), block.second_norm)
    torch.testing.assert_close(block(view[None])[0], (view + change).clamp(min=0))


@torch.no_grad()
def test_columns_become_channels_and_channels_columns():
    refiner = ChannelToHeight(Cuboid((8, 6, 3)), 4, 5, [8, 16], [1, 1]).double()
    volume = torch.randn(2, 4, 8, 6, 3, dtype=torch.float64)
    view = sum(
        torch.einsum("dc,bcxy->bdxy", refiner.fold.weight[:, 4 * z : 4 * z + 4], volume[..., z]) for z in range(3)
    )
    fine = refiner.stages[0](view + refiner.fold.bias[:, None, None])
    coarse = refiner.stages[1](refiner.down[0](fine))
    wide = torch.cat([fine, F.interpolate(coarse, scale_factor=2, mode="bilinear")], dim=1)
    weight = torch.cat([merge.weight[:, :, 0, 0] for merge in refiner.merge], dim=1)
    mixed = torch.einsum("dc,bcxy->bdxy", weight, wide) + (refiner.merge[0].bias + refiner.merge[1].bias)[:, None, None]
    view = refiner.norm(mixed).clamp(min=0)
    result = refiner(volume, SKETCHED)
    assert result.shape == (2, refiner.channels, 8, 6, 3)
    for z in range(3):
        rows = slice(5 * z, 5 * z + 5)
        expected = torch.einsum("dc,bcxy->bdxy", refiner.unfold.weight[rows], view)
        torch.testing.assert_close(result[..., z], expected + refiner.unfold.bias[rows, None, None])
