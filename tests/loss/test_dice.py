import pytest
import torch

from omniocc.loss import Dice


def reference(logits, target):
    rows = logits.double().flatten(2).transpose(1, 2).reshape(-1, logits.shape[1]).softmax(1).tolist()
    pairs = [(p, y) for p, y in zip(rows, target.flatten().tolist(), strict=True) if y != 255]
    terms = []
    for c in sorted({y for _, y in pairs}):
        overlap = sum(p[c] for p, y in pairs if y == c)
        terms.append(1 - 2 * overlap / (sum(p[c] for p, _ in pairs) + sum(y == c for _, y in pairs)))
    return sum(terms) / len(terms)


@pytest.mark.parametrize("labels", [[0, 1, 2, 3], [0, 2, 255], [3]])
def test_agrees_with_loops(labels, batch_of):
    logits, target = batch_of(labels)
    assert float(Dice()(logits, target)) == pytest.approx(reference(logits, target), rel=1e-5)


def test_hand_computed():
    logits = torch.tensor([[[0.0, 100.0], [0.0, 0.0]]])  # voxel 0: half and half, voxel 1: class 0
    target = torch.tensor([[1, 0]], dtype=torch.uint8)
    # class 0: TP 1, FP .5, FN 0 -> 1 - 2/2.5; class 1: TP .5, FP 0, FN .5 -> 1 - 1/1.5
    assert float(Dice()(logits, target)) == pytest.approx((0.2 + 1 / 3) / 2, rel=1e-6)
