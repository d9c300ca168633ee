import math

import pytest
import torch

from omniocc.train.adamw import AdamW, factor_of, warmup_cosine


def test_schedule_literals():
    fractions = [warmup_cosine(step, 4, 104, 0.01) for step in (0, 3, 4, 54, 104, 200)]
    assert fractions == pytest.approx([0.2, 0.8, 1.0, 0.505, 0.01, 0.01])


def test_parts_have_factors_of_the_learning_rate():
    model = torch.nn.ModuleDict({"a": torch.nn.Linear(3, 4), "b": torch.nn.Sequential(torch.nn.Linear(4, 2))})
    model.a.bias.requires_grad_(False)
    groups = AdamW(0.5, 0, 0.0, 0.0).configure(model, 10, {"b": 0.5, "b.0": 0.25})["optimizer"].param_groups
    rates = {id(p): group["initial_lr"] for group in groups for p in group["params"]}
    assert rates == {id(model.a.weight): 0.5, id(model.b[0].weight): 0.125, id(model.b[0].bias): 0.125}


def test_the_longest_name_of_a_part_counts():
    factors = {"backbone": 0.1, "backbone.stem": 0.0}
    names = ("backbone.stem.weight", "backbone.stem2.weight", "backbone.conv.bias", "backbone2.weight")
    assert [factor_of(name, factors) for name in names] == [0.0, 0.1, 0.1, 1.0]


def test_norms_and_biases_are_not_decayed():
    model = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.LayerNorm(4))
    groups = AdamW(0.1, 1, 0.5, 0.0).configure(model, 10)["optimizer"].param_groups
    decayed = {id(p) for group in groups if group["weight_decay"] for p in group["params"]}
    assert decayed == {id(model[0].weight)}
    assert sum(math.prod(p.shape) for group in groups for p in group["params"]) == 12 + 4 + 8
