import pytest
import torch

from omniocc.train import Muon
from omniocc.train.muon import is_matrix, orthogonal


@pytest.mark.parametrize("shape", [(8, 64), (64, 8)])
def test_singular_values_become_about_one_and_vectors_stay(shape):
    torch.manual_seed(0)
    matrix = torch.randn(shape) * torch.logspace(-0.5, 0.5, shape[1])
    found = orthogonal([matrix])[0]
    values = torch.linalg.svdvals(found)
    assert 0.5 < values.min() <= values.max() < 1.3
    left, _, right = torch.linalg.svd(matrix, full_matrices=False)
    cross = left.T @ found @ right.T
    assert (cross - torch.diag(cross.diagonal())).abs().max() < 1e-3


def test_a_first_step_by_hand():
    model = torch.nn.Sequential(torch.nn.Linear(16, 8), torch.nn.Linear(8, 2))
    before = [p.detach().clone() for p in model.parameters()]
    optimizer = Muon(0.1, 0, 0.5, 1.0, momentum=0.9).configure(model, 10)["optimizer"]
    for group in optimizer.param_groups:
        group["lr"] = 0.1
    model(torch.randn(4, 16)).square().sum().backward()
    grads = [p.grad.clone() for p in model.parameters()]
    optimizer.step()
    expected = before[0] * (1 - 0.1 * 0.5) - 0.1 * 0.2 * 16**0.5 * orthogonal(grads[:1])[0]
    torch.testing.assert_close(model[0].weight.detach(), expected, atol=1e-5, rtol=1e-4)
    # the bias, and the weight of two rows, move as by AdamW: by the learning rate towards lower loss
    torch.testing.assert_close(model[0].bias.detach(), before[1] - 0.1 * grads[1].sign(), atol=1e-4, rtol=1e-3)
    decayed = before[2] * (1 - 0.1 * 0.5) - 0.1 * grads[2].sign()
    torch.testing.assert_close(model[1].weight.detach(), decayed, atol=1e-4, rtol=1e-3)


def test_training_goes_on_from_a_saved_state():
    def trained(steps, state=None, weights=None):
        torch.manual_seed(0)
        model = torch.nn.Sequential(torch.nn.Conv2d(3, 8, 3), torch.nn.Flatten(), torch.nn.LazyLinear(9))
        data = torch.rand(5, 3, 6, 6)
        model(data)
        optimizer = Muon(0.02, 0, 0.0, 1.0).configure(model, 10)["optimizer"]
        if state is not None:
            model.load_state_dict(weights)
            optimizer.load_state_dict(state)
        for _ in range(steps):
            optimizer.zero_grad()
            model(data).square().mean().backward()
            optimizer.step()
        return optimizer.state_dict(), model.state_dict()

    state, weights = trained(3)
    _, resumed = trained(2, state, weights)
    _, expected = trained(5)
    for name, value in expected.items():
        torch.testing.assert_close(resumed[name], value)


def test_norms_biases_and_thin_weights_are_not_matrices():
    assert is_matrix(torch.zeros(8, 3, 3, 3))
    assert not any(is_matrix(torch.zeros(shape)) for shape in ((64,), (7, 64), (64, 7), (64, 1)))
