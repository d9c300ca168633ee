import math

import pytest
import torch

from omniocc.loss import Scal
from omniocc.loss.scal import geometric_scal, semantic_scal
from omniocc.loss.soft_confusion import soft_confusion


def voxels(logits, target):
    rows = logits.double().flatten(2).transpose(1, 2).reshape(-1, logits.shape[1]).softmax(1).tolist()
    return [(p, y) for p, y in zip(rows, target.flatten().tolist(), strict=True) if y != 255]


def affinity(scores, truths):
    """Return -(log P + log R + log S) by MonoScene's formulas, in plain loops."""
    hits = sum(p for p, y in zip(scores, truths, strict=True) if y)
    result = -math.log(hits / sum(scores)) - math.log(hits / sum(truths))
    negatives = sum(1 - y for y in truths)
    if negatives:
        result -= math.log(sum(1 - p for p, y in zip(scores, truths, strict=True) if not y) / negatives)
    return result


def semantic_reference(logits, target):
    pairs = voxels(logits, target)
    present = sorted({y for _, y in pairs})
    terms = [affinity([p[c] for p, _ in pairs], [int(y == c) for _, y in pairs]) for c in present]
    return sum(terms) / len(terms)


def geometric_reference(logits, target):
    pairs = voxels(logits, target)
    return affinity([1 - p[0] for p, _ in pairs], [int(y != 0) for _, y in pairs])


def batch(labels, seed=0):
    torch.manual_seed(seed)
    target = torch.tensor(labels, dtype=torch.uint8)[torch.randint(0, len(labels), (2, 3, 4, 2))]
    return 2 * torch.randn(2, 5, 3, 4, 2), target


@pytest.mark.parametrize("labels", [[0, 1, 2, 3, 4], [0, 0, 2, 255], [3], [1, 4, 255]])
def test_semantic_agrees_with_loops(labels):
    logits, target = batch(labels)
    expected = semantic_reference(logits, target)
    assert float(semantic_scal(soft_confusion(logits, target))) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("labels", [[0, 1, 2, 3, 4], [0, 0, 2, 255], [3], [1, 4, 255]])
def test_geometric_agrees_with_loops(labels):
    logits, target = batch(labels)
    expected = geometric_reference(logits, target)
    assert float(geometric_scal(soft_confusion(logits, target))) == pytest.approx(expected, rel=1e-5)


def test_all_free_scores_only_the_free_voxels():
    logits, target = batch([0])
    share = sum(p[0] for p, _ in voxels(logits, target)) / target.numel()
    assert float(geometric_scal(soft_confusion(logits, target))) == pytest.approx(-math.log(share), rel=1e-5)


def test_sum_of_both():
    logits, target = batch([0, 1, 2, 255])
    expected = semantic_reference(logits, target) + geometric_reference(logits, target)
    assert float(Scal()(logits, target)) == pytest.approx(expected, rel=1e-5)


def test_perfect_prediction_is_free_of_loss():
    _, target = batch([0, 1, 2, 3, 4])
    logits = 60 * torch.nn.functional.one_hot(target.long(), 5).movedim(-1, 1).float()
    assert float(Scal()(logits, target)) == pytest.approx(0, abs=1e-5)
