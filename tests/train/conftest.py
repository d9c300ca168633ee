"""Tasks at the size of `preset=smoke`."""

import pytest
import torch

from omniocc.parts import Parts
from omniocc.train.build import build_task


@pytest.fixture(scope="session")
def make_task(smoke, spec):
    def make(*overrides):
        torch.manual_seed(0)
        return build_task(Parts(smoke(*overrides)), spec)

    return make
