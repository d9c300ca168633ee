import torch

from omniocc.model.semantic_head import NoSemanticHead


def test_predicts_nothing():
    assert NoSemanticHead()([torch.rand(1, 2, 3, 4, 5)]) is None
