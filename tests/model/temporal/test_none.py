import torch

from omniocc.model.temporal import NoTemporal


def test_newest_volume_comes_back_untouched():
    old, new = torch.rand(1, 2, 3, 4, 5), torch.rand(1, 2, 3, 4, 5)
    assert NoTemporal()([old, new], torch.eye(4).expand(1, 2, 4, 4), torch.ones(1, 2).bool()) is new
    assert NoTemporal.frames == 1
