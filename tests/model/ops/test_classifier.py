import pytest
import torch

from omniocc.geometry import Cuboid, Cylinder
from omniocc.model.ops.classifier import Classifier, smoothed_fractions

GRID = Cylinder((4, 6, 2))
CLASSES = 4


def make(geometry=GRID, zeros=True):
    classifier = Classifier(geometry, 3, CLASSES)
    classifier.set_class_counts(torch.randint(0, 30, (CLASSES, *geometry.shape)))
    if zeros:
        torch.nn.init.zeros_(classifier.linear.weight)
    return classifier


def hints(batch=2):
    """Log-odds of being occupied, and scores of the occupied classes."""
    return torch.randn(batch, *GRID.shape), torch.randn(batch, *GRID.shape, CLASSES - 1)


def volume(batch=2, geometry=GRID):
    return torch.randn(batch, 3, *geometry.shape)


def test_shares_are_counts_drawn_towards_ring_height_and_grid():
    counts = torch.randint(0, 9, (3, *GRID.shape))
    shares = smoothed_fractions(counts, [1])
    assert torch.allclose(shares.sum(0), torch.ones(GRID.shape))
    equal = 1 / 3
    for r, theta, z in [(0, 0, 0), (3, 5, 1), (2, 1, 0)]:
        for label in range(3):
            share = equal
            for part in (counts, counts[..., z], counts[:, r, :, z], counts[:, r, theta, z]):
                part = part.reshape(3, -1).sum(1).tolist()
                share = (part[label] + 20 * share) / (sum(part) + 20)
            assert float(shares[label, r, theta, z]) == pytest.approx(share, rel=1e-5)


def test_without_rings_the_surroundings_of_a_voxel_are_its_height():
    counts = torch.randint(0, 9, (3, 4, 4, 2))
    shares = smoothed_fractions(counts, [])
    for x, y, z in [(0, 0, 0), (3, 2, 1)]:
        for label in range(3):
            share = 1 / 3
            for part in (counts, counts[..., z], counts[:, x, y, z]):
                part = part.reshape(3, -1).sum(1).tolist()
                share = (part[label] + 20 * share) / (sum(part) + 20)
            assert float(shares[label, x, y, z]) == pytest.approx(share, rel=1e-5)


@pytest.mark.parametrize("geometry", [GRID, Cuboid((4, 4, 2))])
def test_the_first_logits_are_the_frequencies_of_the_training_frames(geometry):
    counts = torch.zeros(CLASSES, *geometry.shape, dtype=torch.int64)
    counts[0], counts[2], counts[3] = 60_000, 30_000, 10_000
    classifier = make(geometry=geometry)
    classifier.set_class_counts(counts)
    probabilities = classifier(volume(geometry=geometry)).softmax(1)
    expected = torch.tensor([0.6, 0.0, 0.3, 0.1])[None, :, None, None, None].expand_as(probabilities)
    torch.testing.assert_close(probabilities, expected, atol=1e-3, rtol=0)


def test_log_odds_decide_free_or_occupied_and_the_frequencies_the_class():
    classifier, (log_odds, _) = make(), hints()
    probabilities = classifier(volume(), log_odds).softmax(1)
    torch.testing.assert_close(1 - probabilities[:, 0], log_odds.sigmoid())
    shares = probabilities[:, 1:] / probabilities[:, 1:].sum(1, keepdim=True)
    torch.testing.assert_close(shares[0], classifier.prior_shares.exp().movedim(-1, 0))


def test_class_scores_multiply_the_frequencies():
    classifier, (log_odds, scores) = make(), hints()
    probabilities = classifier(volume(), log_odds, scores).softmax(1)[:, 1:]
    shares = probabilities / probabilities.sum(1, keepdim=True)
    products = classifier.prior_shares.exp().movedim(-1, 0) * scores.softmax(-1).movedim(-1, 1)
    torch.testing.assert_close(shares, products / products.sum(1, keepdim=True))


def test_equal_scores_keep_the_frequencies():
    classifier, scores = make(), torch.full((2, *GRID.shape, CLASSES - 1), -1.5)
    given, without = classifier(volume(), None, scores), classifier(volume())
    torch.testing.assert_close(given, without.expand(2, -1, -1, -1, -1))


def test_the_linear_map_is_added_and_everything_learns():
    classifier, known, features = make(zeros=False), hints(), volume()
    logits = classifier(features, *known)
    expected = classifier.linear(features) + classifier.start(*known).movedim(-1, 1)
    torch.testing.assert_close(logits, expected)
    logits.square().mean().backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in classifier.parameters())


def test_without_counts_free_is_as_likely_as_all_others_together():
    probabilities = Classifier(GRID, 3, CLASSES).start().exp().detach()
    expected = torch.tensor([0.5, *[0.5 / (CLASSES - 1)] * (CLASSES - 1)])
    torch.testing.assert_close(probabilities[0, 0, 0, 0], expected)
