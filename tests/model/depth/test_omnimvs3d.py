import pytest
import torch

from omniocc.model.depth.omnimvs3d import VolumeNet, resize_panorama
from omniocc.model.ops.depth.projection import Present


@pytest.mark.parametrize("roll", [2, 8])
def test_rolling_the_volume_rolls_the_scores(roll):
    torch.manual_seed(0)
    net = VolumeNet(3, [8, 8]).double()
    volume = torch.randn(1, 3, 5, 7, 12, dtype=torch.float64)
    scores = net(volume)
    assert scores.shape == (1, 6, 7, 12)  # five spheres and the sky
    torch.testing.assert_close(net(volume.roll(roll, -1)), scores.roll(roll, -1))


def test_resizing_keeps_directions():
    columns = torch.arange(6.0).expand(1, 1, 2, 6)
    fine = resize_panorama(columns, 4, 12)
    assert fine[0, 0, 0].tolist() == pytest.approx(
        [1.25, 0.25, 0.75, 0.25 + 1, 1.75, 2.25, 2.75, 3.25, 3.75, 4.25, 4.75, 3.75]
    )
    assert resize_panorama(columns, 2, 6) is columns


def test_sizes_that_do_not_fit_are_named(small):
    with pytest.raises(ValueError, match="multiples of 4"):
        small("OmniMVS3D", width=46)


def test_equal_features_have_no_variance_in_half_precision_either(small, fisheye):
    net, present = small("OmniMVS3D"), Present(torch.ones(1, 6, dtype=torch.bool), True)
    features = torch.randn(1, 1, 4, 1, 1).expand(1, 6, 4, 16, 32).bfloat16()
    variance = net.sweep(features, present, fisheye)[0][:, 4:]
    assert variance.abs().max() < 1e-5
