import math

import pytest
import torch

from omniocc.loss import CrossEntropy


def softmax_rows(logits):
    exact = logits.double().flatten(2).transpose(1, 2).reshape(-1, logits.shape[1])
    exact = exact - exact.max(1, keepdim=True).values
    return exact.exp() / exact.exp().sum(1, keepdim=True)


def reference(logits, target, weights):
    total = norm = 0.0
    for row, label in zip(softmax_rows(logits).tolist(), target.flatten().tolist(), strict=True):
        if label != 255:
            total -= weights[label] * math.log(row[label])
            norm += weights[label]
    return total / norm


def batch(seed=0):
    torch.manual_seed(seed)
    target = torch.randint(0, 4, (2, 3, 4, 2), dtype=torch.uint8)
    target[0, 0] = 255
    return torch.randn(2, 4, 3, 4, 2), target


def test_weights_follow_the_formula():
    loss = CrossEntropy(2.0, 4)
    assert loss.weights.tolist() == [1, 1, 1, 1]
    loss.set_class_counts(torch.tensor([900, 90, 10, 0]))
    expected = [1 / math.log(2.9), 1 / math.log(2.09), 1 / math.log(2.01), 1 / math.log(2)]
    torch.testing.assert_close(loss.weights, torch.tensor(expected))


def test_agrees_with_a_loop_in_float64():
    logits, target = batch()
    loss = CrossEntropy(2.0, 4)
    assert float(loss(logits, target)) == pytest.approx(reference(logits, target, [1.0] * 4), rel=1e-6)
    loss.set_class_counts(torch.tensor([900, 90, 10, 0]))
    expected = reference(logits, target, loss.weights.tolist())
    assert float(loss(logits, target)) == pytest.approx(expected, rel=1e-6)


def test_weights_travel_in_the_state_dict():
    loss = CrossEntropy(1.5, 4)
    loss.set_class_counts(torch.tensor([7, 1, 1, 1]))
    again = CrossEntropy(1.5, 4)
    again.load_state_dict(loss.state_dict())
    assert torch.equal(again.weights, loss.weights)


def test_constant_that_gives_negative_weights_is_refused():
    with pytest.raises(ValueError, match=r"constant is 0\.001"):
        CrossEntropy(0.001, 4)
