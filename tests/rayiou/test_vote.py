import re

import pytest
import torch

from omniocc.geometry import downsample
from rayiou.vote import majority_vote


def vote(block):
    """Return the label of one block by the rule."""
    occupied = [label for label in block if label not in (0, 255)]
    if occupied:
        return max(sorted(set(occupied), reverse=True), key=occupied.count)
    return 255 if 2 * block.count(255) > len(block) else 0


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_agrees_with_the_rule_block_by_block(factor):
    generator = torch.Generator().manual_seed(0)
    fine = torch.randint(0, 12, (2, 12, 6, 6), generator=generator, dtype=torch.uint8)
    fine[torch.rand(fine.shape, generator=generator) < 0.7] = 0
    fine[torch.rand(fine.shape, generator=generator) < 0.5] = 255
    coarse = downsample(fine, factor)
    assert coarse.shape == (2, 12 // factor, 6 // factor, 6 // factor)
    for b, x, y, z in torch.cartesian_prod(*map(torch.arange, coarse.shape)).tolist():
        window = [slice(i * factor, (i + 1) * factor) for i in (x, y, z)]
        assert coarse[b, x, y, z] == vote(fine[b][tuple(window)].flatten().tolist())


def test_a_thin_object_survives():
    fine = torch.zeros(4, 4, 4, dtype=torch.uint8)
    fine[:, :, 2:] = 255
    fine[1, 1] = 9  # a pole
    coarse = downsample(fine, 2)
    assert coarse[0, 0].tolist() == [9, 9]
    assert coarse[1, 1].tolist() == [0, 255]


def test_turning_a_cylinder_by_whole_blocks_turns_the_result():
    fine = torch.randint(0, 12, (4, 12, 4), generator=torch.Generator().manual_seed(1), dtype=torch.uint8)
    assert torch.equal(downsample(fine.roll(4, dims=1), 2), downsample(fine, 2).roll(2, dims=1))


@pytest.mark.parametrize(("shape", "factor"), [((4, 5, 4), 2), ((4, 4, 4), 3), ((4, 4, 4), 0)])
def test_error_names_sizes_that_do_not_fit(shape, factor):
    with pytest.raises(ValueError, match=rf"factor {factor}.*\(4"):
        downsample(torch.zeros(shape, dtype=torch.uint8), factor)


@pytest.mark.parametrize("wrong", [torch.tensor([1.0, 3.6]), torch.tensor([1.0, torch.nan]), torch.tensor([1, -1])])
def test_labels_that_are_no_classes_are_refused(wrong):
    shown = re.escape(str([wrong[1].item()]))
    with pytest.raises(ValueError, match=rf"class 1..11 or 255 \(unknown\), got labels {shown}"):
        majority_vote(torch.tensor([0, 0]), wrong, 1)
    with pytest.raises(ValueError, match=rf"classes 0..11 or 255 \(unknown\), got {shown}"):
        downsample(wrong.reshape(2, 1, 1), 1)
    with pytest.raises(ValueError, match=r"classes 0..11 or 255 \(unknown\), got \[17\]"):
        downsample(torch.full((1, 1, 1), 17, dtype=torch.uint8), 1)
    assert majority_vote(torch.tensor([0, 0, 1]), torch.tensor([7.0, 7.0, 255.0]), 3).tolist() == [7, 255, 0]
