"""`loss=paper` against eq. 3 to 5 of the paper, term by term, in plain float64 loops over voxels and classes."""

import math
from typing import NamedTuple

import pytest
import torch

from omniocc.config import build

CLASSES = 12
COUNTS = [90_000, 4_000, 2_500, 900, 700, 50, 40, 300, 20, 5, 1_400, 85]


class Prediction(NamedTuple):
    logits: torch.Tensor
    pixel_logits: torch.Tensor | None
    range_logits: torch.Tensor | None = None
    run_lengths: torch.Tensor | None = None
    coarse_logits: tuple[tuple[int, torch.Tensor], ...] = ()


@pytest.fixture(scope="module")
def loss(smoke):
    loss = build(smoke("loss=paper").loss)
    loss.set_class_counts(torch.tensor(COUNTS))
    return loss


@pytest.fixture(scope="module")
def batch():
    torch.manual_seed(0)
    voxels = torch.randint(0, CLASSES - 2, (2, 5, 4, 3), dtype=torch.uint8)  # two classes do not occur
    voxels[0, 0] = 255
    pixels = torch.randint(0, CLASSES, (2, 3, 4, 8), dtype=torch.uint8)
    pixels[:, :, 0] = 255
    return Prediction(torch.randn(2, CLASSES, 5, 4, 3), torch.randn(2, 3, CLASSES, 4, 8)), voxels, pixels


def rows(logits, labels):
    """Return (probabilities, label) of every known cell."""
    flat = logits.double().movedim(1, -1).reshape(-1, CLASSES)
    return [
        (torch.softmax(row, 0).tolist(), label)
        for row, label in zip(flat, labels.flatten().tolist(), strict=True)
        if label != 255
    ]


def weighted_cross_entropy(known):
    weights = [1 / math.log(count / sum(COUNTS) + 2.0) for count in COUNTS]
    return sum(-weights[y] * math.log(p[y]) for p, y in known) / sum(weights[y] for _, y in known)


def affinity(mass, truth, specific=True):
    """Return -(log precision + log recall + log specificity) of one class from probability and truth by voxel."""
    hits = sum(p for p, is_it in zip(mass, truth, strict=True) if is_it)
    rejected = sum(1 - p for p, is_it in zip(mass, truth, strict=True) if not is_it)
    total = math.log(hits / sum(mass)) + math.log(hits / sum(truth))
    return -(total + math.log(rejected / (len(truth) - sum(truth)))) if specific else -total


def scene_class_affinity(known):
    present = sorted({y for _, y in known})
    semantic = [affinity([p[c] for p, _ in known], [y == c for _, y in known]) for c in present]
    geometric = affinity([1 - p[0] for p, _ in known], [y != 0 for _, y in known])
    return sum(semantic) / len(semantic) + geometric


def dice(known):
    losses = []
    for c in sorted({y for _, y in known}):
        tp = sum(p[c] for p, y in known if y == c)
        fp = sum(p[c] for p, y in known if y != c)
        fn = sum(1 - p[c] for p, y in known if y == c)
        losses.append(1 - 2 * tp / (2 * tp + fp + fn))
    return sum(losses) / len(losses)


def cross_entropy(known):
    return sum(-math.log(p[y]) for p, y in known) / len(known)


def test_every_term_equals_the_paper(loss, batch):
    prediction, voxels, pixels = batch
    terms = {name: float(term) for name, term in loss(prediction, voxels, pixels).items()}
    known = rows(prediction.logits, voxels)
    known_pixels = rows(prediction.pixel_logits.flatten(0, 1), pixels.flatten(0, 1))
    expected = {
        "ce": weighted_cross_entropy(known),
        "scal": scene_class_affinity(known),
        "dice": dice(known),
        "semantics": cross_entropy(known_pixels),
    }
    assert terms == pytest.approx(expected, rel=1e-5)


def test_no_term_is_weighed_twice(loss):
    assert set(loss.weights.values()) == {1.0}
