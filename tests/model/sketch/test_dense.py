import torch

from omniocc.model.sketch import Dense


def test_all_voxels_are_candidates(geometry, fisheye):
    candidates, *others = Dense(geometry)(torch.zeros(2, 6, 3, 4, 4), (fisheye, fisheye))
    assert others == [None]
    assert candidates.shape == (2, *geometry.shape)
    assert candidates.dtype == torch.bool
    assert candidates.all()
