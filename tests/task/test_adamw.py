import math

import pytest
import torch

from omniocc.task.adamw import AdamW, warmup_cosine


def test_schedule_literals():
    fractions = [warmup_cosine(step, 4, 104, 0.01) for step in (0, 3, 4, 54, 104, 200)]
    assert fractions == pytest.approx([0.2, 0.8, 1.0, 0.505, 0.01, 0.01])


def test_norms_and_biases_are_not_decayed():
    model = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.LayerNorm(4))
    groups = AdamW(0.1, 1, 0.5, 0.0).configure(model, 10)["optimizer"].param_groups
    decayed = {id(p) for group in groups if group["weight_decay"] for p in group["params"]}
    assert decayed == {id(model[0].weight)}
    assert sum(math.prod(p.shape) for group in groups for p in group["params"]) == 12 + 4 + 8
