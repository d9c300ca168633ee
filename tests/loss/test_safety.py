"""Extreme inputs for every voxel loss."""

import pytest
import torch

from omniocc.loss import CrossEntropy, Dice, Lovasz, SceneClassAffinity

LOSSES = [CrossEntropy(2.0, 12), SceneClassAffinity(), Dice(), Lovasz()]
by_name = pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)


@by_name
@pytest.mark.parametrize("labels", [[0], [7], [255], [0, 3, 255], list(range(12))], ids=str)
@pytest.mark.parametrize("scale", [1.0, 50.0, 5000.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_finite_with_finite_gradients(loss, labels, scale, dtype):
    torch.manual_seed(1)
    logits = (scale * torch.randn(2, 12, 4, 5, 3)).to(dtype).requires_grad_()
    target = torch.tensor(labels, dtype=torch.uint8)[torch.randint(0, len(labels), (2, 4, 5, 3))]
    value = loss(logits, target)
    value.backward()
    assert value.dtype == torch.float32
    assert value.isfinite()
    assert logits.grad.isfinite().all()
    if labels == [255]:
        assert value == 0
        assert not logits.grad.any()


@by_name
def test_autocast_changes_nothing(loss):
    logits = torch.randn(2, 12, 4, 5, 3)
    target = torch.randint(0, 12, (2, 4, 5, 3), dtype=torch.uint8)
    expected = loss(logits, target)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(loss(logits, target), expected)


@by_name
def test_unknown_voxels_have_no_gradient(loss):
    logits = torch.randn(2, 12, 4, 5, 3, requires_grad=True)
    target = torch.randint(0, 12, (2, 4, 5, 3), dtype=torch.uint8)
    target[1, 2] = 255
    loss(logits, target).backward()
    assert not logits.grad[1, :, 2].any()
    assert logits.grad[0].abs().sum() > 0


@by_name
def test_descent_finds_the_target(loss):
    torch.manual_seed(0)
    target = torch.tensor([0, 0, 0, 1, 4, 11, 255], dtype=torch.uint8)[torch.randint(0, 7, (2, 4, 5, 3))]
    logits = torch.zeros(2, 12, 4, 5, 3, requires_grad=True)
    optimizer = torch.optim.Adam([logits], lr=0.3)
    for _ in range(60):
        optimizer.zero_grad()
        loss(logits, target).backward()
        optimizer.step()
    known = target != 255
    assert torch.equal(logits.argmax(1)[known], target[known].long())
