import torch

from omniocc.model.refiner import NoRefiner
from omniocc.model.sketch import Sketched

SKETCHED = Sketched(torch.ones(1, 1, 1, 1, dtype=torch.bool))


def test_volume_comes_back_untouched():
    volume = torch.rand(1, 7, 3, 4, 5)
    refiner = NoRefiner(7)
    assert refiner(volume, SKETCHED) is volume
    assert refiner.channels == 7
