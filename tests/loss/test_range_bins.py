import math

import pytest
import torch

from omniocc.loss import RangeBins


def nearest(cell):
    """Return the smallest range of a block, inf if all are unknown or sky."""
    return min((value for value in cell.flatten().tolist() if not math.isnan(value)), default=math.inf)


def by_hand(logits, range_m, begin_m, end_m):
    """Return the loss computed one cell after the other."""
    bins, height, width = logits.shape[2:]
    rows, columns = range_m.shape[-2] // height, range_m.shape[-1] // width
    losses = []
    for sample, camera, row, column in torch.cartesian_prod(*map(torch.arange, (*logits.shape[:2], height, width))):
        block = range_m[sample, camera, row * rows : (row + 1) * rows, column * columns : (column + 1) * columns]
        if not begin_m <= nearest(block) < end_m:
            continue
        target = int((nearest(block) - begin_m) // ((end_m - begin_m) / bins))
        losses.append(-logits[sample, camera, :, row, column].softmax(0)[target].log())
    return torch.stack(losses).mean()


def test_equals_a_loop_over_cells():
    torch.manual_seed(0)
    range_m = torch.rand(2, 3, 8, 12) * 14
    range_m[0, 0, :3], range_m[1, 2, :, 5:] = math.inf, math.nan
    logits = torch.randn(2, 3, 5, 4, 6)
    expected = by_hand(logits.double(), range_m.double(), 2.0, 12.0)
    torch.testing.assert_close(RangeBins((2.0, 12.0))(logits, range_m).double(), expected, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize(("range_m", "target"), [(2.0, 0), (3.99, 0), (4.0, 1), (11.999, 4)])
def test_a_bin_holds_its_lower_edge(range_m, target):
    logits = torch.zeros(1, 1, 5, 1, 1)
    logits[0, 0, target] = 50.0
    assert RangeBins((2.0, 12.0))(logits, torch.full((1, 1, 2, 2), range_m)) < 1e-6


@pytest.mark.parametrize("range_m", [math.nan, math.inf, 1.9, 12.0])
def test_cells_of_sky_ego_vehicle_and_outside_the_bins_do_not_count(range_m):
    logits = torch.randn(1, 1, 5, 1, 1, requires_grad=True)
    loss = RangeBins((2.0, 12.0))(logits, torch.full((1, 1, 2, 2), range_m))
    loss.backward()
    assert loss == 0
    assert logits.grad.abs().sum() == 0


def test_maps_that_do_not_divide_the_image_are_covered():
    range_m = torch.full((1, 1, 7, 5), 30.0)
    range_m[0, 0, 6, 4] = 3.0
    logits = torch.zeros(1, 1, 5, 3, 2)
    logits[0, 0, 0, 2, 1] = 50.0
    assert RangeBins((2.0, 12.0))(logits, range_m) < 1e-6
