import pytest
import torch


def compare(result, expected, tensors):
    """Compare two results, and their gradients in `tensors` for random weights of the results."""
    torch.testing.assert_close(result, expected)
    weights = torch.randn_like(result)
    gradients = torch.autograd.grad((result * weights).sum(), tensors)
    references = torch.autograd.grad((expected * weights).sum(), tensors)
    for gradient, reference in zip(gradients, references, strict=True):
        torch.testing.assert_close(gradient, reference)


@pytest.fixture
def assert_same_gradients():
    return compare
