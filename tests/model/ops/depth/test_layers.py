import pytest
import torch

from omniocc.model.ops.depth.layers import PanoramaConv, UNet2d, window_argmax


@pytest.mark.parametrize("roll", [4, 12])
def test_rolling_the_panorama_rolls_the_answer(roll):
    torch.manual_seed(0)
    net = UNet2d([8, 8, 16], blocks=1, wrap=True).double()
    maps = torch.randn(1, 8, 7, 16, dtype=torch.float64)
    out = net(maps)
    assert out.shape == maps.shape
    torch.testing.assert_close(net(maps.roll(roll, -1)), out.roll(roll, -1))
    assert not torch.allclose(net(maps.roll(1, -1)), out.roll(1, -1))


def test_convolution_wraps_around_the_seam():
    conv = PanoramaConv(1, 1, 3, wrap=True, bias=False)
    torch.nn.init.ones_(conv.weight)
    maps = torch.zeros(1, 1, 3, 6)
    maps[0, 0, 1, 0] = 1
    assert conv(maps)[0, 0, 1].tolist() == [1, 1, 0, 0, 0, 1]
    flat = PanoramaConv(1, 1, 3, wrap=False, bias=False)
    torch.nn.init.ones_(flat.weight)
    assert flat(maps)[0, 0, 1].tolist() == [1, 1, 0, 0, 0, 0]


@pytest.mark.parametrize("wrap", [True, False])
def test_mirrored_weights_mirror_the_answer(wrap):
    torch.manual_seed(0)
    net, twin = (UNet2d([8, 16], blocks=1, wrap=wrap).double() for _ in range(2))
    twin.load_state_dict({k: v.flip(-1) if v.ndim == 4 else v for k, v in net.state_dict().items()})
    maps = torch.randn(1, 8, 6, 8, dtype=torch.float64)
    torch.testing.assert_close(twin(maps.flip(-1)), net(maps).flip(-1))


def test_odd_sizes_without_wrap():
    assert UNet2d([8, 8, 8], blocks=1, wrap=False)(torch.randn(1, 8, 9, 7)).shape == (1, 8, 9, 7)


def test_a_width_that_cannot_be_halved_is_named():
    with pytest.raises(ValueError, match=r"multiples of 4.* 10"):
        UNet2d([8, 8, 8], blocks=1, wrap=True)(torch.randn(1, 8, 8, 10))


def test_channels_must_split_into_groups():
    with pytest.raises(ValueError, match="12 channels"):
        UNet2d([12], blocks=1, wrap=False)


@pytest.mark.parametrize("true", [3.0, 3.25, 3.5, 6.9])
def test_fractions_between_spheres(true):
    # the answer lies between two neighbours according to their probabilities
    probability = torch.full((1, 10, 1, 1), 1e-9)
    lower = int(true)
    probability[0, lower], probability[0, lower + 1] = 1 - (true - lower), true - lower + 1e-9
    index, confidence = window_argmax(probability.log(), 2)
    assert index.item() == pytest.approx(true, abs=1e-4)
    assert confidence.item() == pytest.approx(1, abs=1e-4)


def test_one_of_two_surfaces_not_between_them():
    probability = torch.full((1, 20, 1, 1), 1e-9)
    probability[0, 4:7, 0, 0] = torch.tensor([0.1, 0.4, 0.1])
    probability[0, 15, 0, 0] = 0.4
    index, confidence = window_argmax(probability.log(), 2)
    assert index.item() == pytest.approx(5, abs=1e-3)
    assert confidence.item() == pytest.approx(0.6, abs=1e-3)


def test_windows_end_with_the_spheres():
    logits = torch.full((1, 6, 1, 2), -20.0)
    logits[0, 0, 0, 0] = logits[0, 5, 0, 1] = 0
    index, _ = window_argmax(logits, 2)
    torch.testing.assert_close(index, torch.tensor([[[0.0, 5.0]]]), atol=1e-4, rtol=0)
