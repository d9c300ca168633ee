import math

import pytest
import torch

from omniocc.loss import SceneClassAffinity
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


@pytest.mark.parametrize("labels", [[0, 1, 2, 3, 4], [0, 0, 2, 255], [3], [1, 4, 255]])
def test_semantic_agrees_with_loops(labels, batch_of):
    logits, target = batch_of(labels, 5)
    expected = semantic_reference(logits, target)
    assert float(semantic_scal(soft_confusion(logits, target))) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("labels", [[0, 1, 2, 3, 4], [0, 0, 2, 255], [3], [1, 4, 255]])
def test_geometric_agrees_with_loops(labels, batch_of):
    logits, target = batch_of(labels, 5)
    expected = geometric_reference(logits, target)
    assert float(geometric_scal(soft_confusion(logits, target))) == pytest.approx(expected, rel=1e-5)


def test_all_free_scores_only_the_free_voxels(batch_of):
    logits, target = batch_of([0], 5)
    fraction = sum(p[0] for p, _ in voxels(logits, target)) / target.numel()
    assert float(geometric_scal(soft_confusion(logits, target))) == pytest.approx(-math.log(fraction), rel=1e-5)


def test_perfect_prediction_is_free_of_loss(batch_of):
    _, target = batch_of([0, 1, 2, 3, 4], 5)
    logits = 60 * torch.nn.functional.one_hot(target.long(), 5).movedim(-1, 1).float()
    assert float(SceneClassAffinity()(logits, target)) == pytest.approx(0, abs=1e-5)
