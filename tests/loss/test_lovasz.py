import pytest
import torch

from omniocc.loss import Lovasz
from omniocc.loss.lovasz import jaccard_steps


def jaccard_loss(truth, wrong):
    """Return the loss of a class with cells `truth` and wrong cells `wrong`: 1 - hits / (truth or predicted)."""
    return 1 - len(truth - wrong) / len(truth | wrong)


def reference(logits, target):
    """Return the sum over sorted errors, set by set (Berman et al. 2018, eq. 8 and 9)."""
    rows = logits.double().flatten(2).transpose(1, 2).reshape(-1, logits.shape[1]).softmax(1).tolist()
    pairs = [(p, y) for p, y in zip(rows, target.flatten().tolist(), strict=True) if y != 255]
    losses = []
    for c in sorted({y for _, y in pairs}):
        truth = {i for i, (_, y) in enumerate(pairs) if y == c}
        errors = [1 - p[c] if y == c else p[c] for p, y in pairs]
        wrong, before, loss = set(), 0.0, 0.0
        for i in sorted(range(len(errors)), key=lambda i: -errors[i]):
            wrong.add(i)
            after = jaccard_loss(truth, wrong)
            loss += errors[i] * (after - before)
            before = after
        losses.append(loss)
    return sum(losses) / len(losses)


@pytest.mark.parametrize("labels", [[0, 1, 2, 3], [0, 1, 255], [3], [0]])
def test_agrees_with_sets(labels, batch_of):
    logits, target = batch_of(labels)
    assert float(Lovasz()(logits, target)) == pytest.approx(reference(logits, target), rel=1e-5)


def test_of_hard_predictions_it_is_the_jaccard_loss():
    target = torch.tensor([[1, 1, 1, 0, 0, 255]], dtype=torch.uint8)
    predicted = torch.tensor([1, 1, 0, 1, 0, 1])
    logits = 200.0 * torch.nn.functional.one_hot(predicted, 2).T[None].float()
    # class 1: 2 of 4, class 0: 1 of 3
    assert float(Lovasz()(logits, target)) == pytest.approx((1 - 2 / 4 + 1 - 1 / 3) / 2, rel=1e-6)


def test_steps_by_hand():
    # two of the class, errors in the order class, other, class: losses 1/2, 2/3, 1
    steps = jaccard_steps(torch.tensor([[1.0, 0.0, 1.0]]))
    assert steps[0].tolist() == pytest.approx([1 / 2, 1 / 6, 1 / 3])


def test_gradient_agrees_with_differences():
    torch.manual_seed(0)
    logits = torch.randn(1, 2, 6, requires_grad=True)
    target = torch.tensor([[0, 1, 1, 0, 255, 1]], dtype=torch.uint8)
    Lovasz()(logits, target).backward()
    for at in ((0, 1, 1), (0, 0, 3), (0, 1, 4)):
        step = torch.zeros_like(logits)
        step[at] = 1e-4
        rise = reference(logits.detach().double() + step, target) - reference(logits.detach().double() - step, target)
        assert float(logits.grad[at]) == pytest.approx(rise / 2e-4, abs=1e-4)
