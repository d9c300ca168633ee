import math

import pytest
import torch

from omniocc.loss import Semantics
from omniocc.loss.semantics import labels_at


def test_labels_are_read_at_cell_centres():
    labels = torch.arange(48, dtype=torch.uint8).reshape(1, 1, 6, 8)
    # 2 x 2 cells of 3 x 4 pixels: centres (u, v) = (1.5, 1), (5.5, 1), (1.5, 4), (5.5, 4); ties to the right
    assert labels_at(labels, 2, 2).flatten().tolist() == [10, 14, 34, 38]
    assert torch.equal(labels_at(labels, 6, 8), labels)


def test_agrees_with_a_loop():
    torch.manual_seed(0)
    logits = torch.randn(2, 3, 4, 3, 5)
    labels = torch.randint(0, 4, (2, 3, 6, 10), dtype=torch.uint8)
    labels[labels == 3] = 255
    terms = []
    for b, n, i, j in torch.cartesian_prod(*(torch.arange(k) for k in (2, 3, 3, 5))).tolist():
        label = int(labels[b, n, 2 * i + 1, 2 * j + 1])
        if label != 255:
            row = logits[b, n, :, i, j].double().tolist()
            terms.append(math.log(sum(math.exp(x) for x in row)) - row[label])
    assert float(Semantics()(logits, labels)) == pytest.approx(sum(terms) / len(terms), rel=1e-6)


def test_nothing_known_is_zero_with_gradient():
    logits = torch.randn(1, 2, 4, 3, 5, requires_grad=True)
    loss = Semantics()(logits, torch.full((1, 2, 6, 10), 255, dtype=torch.uint8))
    loss.backward()
    assert loss == 0
    assert not logits.grad.any()
