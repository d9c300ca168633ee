import torch

from omniocc.model.refiner import NoRefiner


def test_volume_comes_back_untouched():
    volume = torch.rand(1, 7, 3, 4, 5)
    refiner = NoRefiner(7)
    assert refiner(volume) is volume
    assert refiner.channels == 7
