import pytest
import torch

from omniocc.model.depth import Depth

INF, NAN = float("inf"), float("nan")


def test_range_is_returned_and_sky_is_not_valid(small, rig):
    truth = small("Truth", width=3, height=1, spheres=11, min_range_m=2.0)
    depth = truth(torch.zeros(2, 6, 3, 36, 64), (rig, rig), torch.tensor([[[2.0, 5.0, INF]], [[1.0, 20.0, NAN]]]))
    assert isinstance(truth, Depth)
    assert depth.range_m.flatten().tolist() == [2, 5, 200, 1, 20, 200]
    assert depth.index.flatten().tolist() == pytest.approx([10, 4, 0, 10, 1, 0])
    assert depth.valid.flatten().tolist() == [True, True, False, True, True, False]
    assert depth.confidence.flatten().tolist() == [1, 1, 0, 1, 1, 0]


def test_without_truth_the_remedy_is_named(small, rig):
    with pytest.raises(ValueError, match="choose another model/depth"):
        small("Truth")(torch.zeros(1, 6, 3, 36, 64), (rig,))


def test_another_size_is_named(small, rig):
    with pytest.raises(ValueError, match=r"\(2, 3\) px, the panorama \(12, 48\)"):
        small("Truth")(torch.zeros(1, 6, 3, 36, 64), (rig,), torch.ones(1, 2, 3))
