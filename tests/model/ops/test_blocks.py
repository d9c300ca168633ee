import itertools

import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.blocks import block_any, block_means, coarsened, repeat_blocks

BLOCK = (2, 3, 1)
SHAPE = (4, 6, 2)


def test_coarser_grids_cover_the_same_space():
    fine = Cylinder((8, 12, 4), (1.0, 9.0), (-2.0, 3.0))
    assert coarsened(fine, (2, 3, 4)) == Cylinder((4, 4, 1), (1.0, 9.0), (-2.0, 3.0))
    cuboid = Cuboid((8, 6, 4), (-3.0, 9.0), (-5.0, 2.0), (-2.0, 3.0))
    assert coarsened(cuboid, (1, 2, 2)) == Cuboid((8, 3, 2), (-3.0, 9.0), (-5.0, 2.0), (-2.0, 3.0))


def test_grids_that_do_not_divide_are_named():
    with pytest.raises(ValueError, match=r"8x12x4.*blocks.*2x2x3"):
        coarsened(Cylinder((8, 12, 4)), (2, 2, 3))


def test_blocks_by_loops():
    mask, volume = torch.rand(2, *SHAPE) < 0.15, torch.randn(2, 3, *SHAPE, dtype=torch.float64)
    some, means = block_any(mask, BLOCK), block_means(volume, BLOCK)
    repeated = repeat_blocks(means, BLOCK)
    assert 0 < some.sum() < some.numel()
    for x, y, z in itertools.product(range(2), range(2), range(2)):
        cells = (slice(2 * x, 2 * x + 2), slice(3 * y, 3 * y + 3), slice(z, z + 1))
        for sample in range(2):
            assert some[sample, x, y, z] == mask[(sample, *cells)].any()
            mean = volume[(sample, slice(None), *cells)].mean((1, 2, 3))
            torch.testing.assert_close(means[sample, :, x, y, z], mean)
            assert (repeated[(sample, slice(None), *cells)] == means[sample, :, x, y, z, None, None, None]).all()


def test_means_undo_repetition():
    coarse = torch.randn(2, 3, 2, 2, 2, dtype=torch.float64)
    torch.testing.assert_close(block_means(repeat_blocks(coarse, BLOCK), BLOCK), coarse)
