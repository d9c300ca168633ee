import pytest
import torch

from omniocc.model.ops.padding import Conv3d, Downsample, Pointwise, pad3d, upsample

THETA = (False, True, False)
NONE = (False, False, False)


def test_pad_wraps_periodic_axes_and_fills_others_with_zeros():
    volume = torch.arange(1.0, 7.0).reshape(1, 1, 2, 3, 1)
    padded = pad3d(volume, (1, 1, 0), THETA)[0, 0, :, :, 0]
    assert padded.tolist() == [[0, 0, 0, 0, 0], [3, 1, 2, 3, 1], [6, 4, 5, 6, 4], [0, 0, 0, 0, 0]]


def test_wrapping_more_cells_than_exist_is_an_error():
    with pytest.raises(ValueError, match="cannot wrap 4 cells"):
        pad3d(torch.zeros(1, 1, 2, 3, 2), (0, 4, 0), THETA)


@pytest.mark.parametrize("roll", [1, 4, 8])
def test_convolution_commutes_with_rolling(roll):
    conv = Conv3d(3, 5, 3, THETA).double()
    volume = torch.randn(2, 3, 5, 12, 4, dtype=torch.float64)
    expected = conv(volume).roll(roll, dims=3)
    assert expected.shape == (2, 5, 5, 12, 4)
    torch.testing.assert_close(conv(volume.roll(roll, dims=3)), expected)


def test_convolution_without_periodic_axes_is_the_plain_one():
    conv = Conv3d(3, 5, 3, NONE)
    volume = torch.randn(1, 3, 4, 5, 6)
    expected = torch.nn.functional.conv3d(volume, conv.weight, conv.bias, padding=1)
    torch.testing.assert_close(conv(volume), expected)


def test_pointwise_is_a_convolution_of_size_one():
    layer = Pointwise(3, 5)
    volume = torch.randn(2, 3, 4, 5, 6)
    expected = torch.nn.functional.conv3d(volume, layer.weight[:, :, None, None, None], layer.bias)
    torch.testing.assert_close(layer(volume), expected)


@pytest.mark.parametrize("cells", [100, 200, 12])
def test_two_halvings_and_doublings_commute_with_rolling_by_four(cells):
    down = [Downsample(2, 2, THETA).double() for _ in range(2)]

    def there_and_back(volume):
        half = down[0](volume)
        quarter = down[1](half)
        assert quarter.shape[2:] == (2, cells // 4, 2)
        return upsample(upsample(quarter, half.shape[2:], THETA), volume.shape[2:], THETA)

    volume = torch.randn(1, 2, 5, cells, 8, dtype=torch.float64)  # 5 -> 3 -> 2 -> 3 -> 5
    assert there_and_back(volume).shape == volume.shape
    torch.testing.assert_close(there_and_back(volume.roll(8, dims=3)), there_and_back(volume).roll(8, dims=3))


def test_downsample_takes_pairs_of_cells_and_a_zero_beyond_an_odd_end():
    down = Downsample(1, 1, NONE)
    torch.nn.init.ones_(down.weight)
    torch.nn.init.zeros_(down.bias)
    volume = torch.arange(1.0, 4.0).reshape(1, 1, 3, 1, 1)
    assert down(volume).flatten().tolist() == [3, 3]


def test_downsampling_an_odd_periodic_axis_is_an_error():
    with pytest.raises(ValueError, match="periodic axis of 5 cells"):
        Downsample(1, 1, THETA)(torch.zeros(1, 1, 2, 5, 2))


def test_upsample_interpolates_across_the_seam_only_where_periodic():
    volume = torch.tensor([0.0, 4.0]).reshape(1, 1, 1, 2, 1)
    assert upsample(volume, (1, 4, 1), THETA).flatten().tolist() == [1, 1, 3, 3]
    assert upsample(volume, (1, 4, 1), NONE).flatten().tolist() == [0, 1, 3, 4]
