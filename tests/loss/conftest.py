"""Random logits and labels of voxels."""

import pytest
import torch


def make_batch(labels, num_classes=4):
    torch.manual_seed(0)
    target = torch.tensor(labels, dtype=torch.uint8)[torch.randint(0, len(labels), (2, 3, 4, 2))]
    return 2 * torch.randn(2, num_classes, 3, 4, 2), target


@pytest.fixture
def batch_of():
    """Return a function of labels and the number of classes, which gives logits and a target with these labels."""
    return make_batch
