import cv2
import numpy as np
import pytest

from omniocc.data.augment.degrade import add_noise, blur, change_exposure, compress_jpeg

IMAGE = np.random.default_rng(0).integers(0, 256, (36, 64, 3), dtype=np.uint8)


def linear(value):
    """Return linear light of a value of sRGB, as in IEC 61966-2-1."""
    v = value / 255
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


@pytest.mark.parametrize("stops", [-2, -1, 1, 2])
def test_exposure_multiplies_linear_light_by_powers_of_two(stops):
    changed = change_exposure(IMAGE, stops)
    for old, new in zip(IMAGE.ravel()[::50].tolist(), changed.ravel()[::50].tolist(), strict=True):
        wanted = min(linear(old) * 2**stops, 1)
        nearest = min(range(256), key=lambda value: abs(linear(value) - wanted))
        assert abs(nearest - new) <= 1
    assert (change_exposure(IMAGE, 2) == 255).mean() > 0.3
    np.testing.assert_array_equal(change_exposure(IMAGE, 0), IMAGE)


def test_noise_has_this_standard_deviation_and_comes_from_its_generator():
    grey = np.full((200, 200, 3), 128, np.uint8)
    found = add_noise(grey, 5, np.random.default_rng(1)).astype(float) - 128
    assert found.std() == pytest.approx(0.05 * 255, rel=0.02)
    assert abs(found.mean()) < 0.2
    np.testing.assert_array_equal(
        add_noise(grey, 5, np.random.default_rng(1)), add_noise(grey, 5, np.random.default_rng(1))
    )


def test_blur_spreads_a_point_as_a_gaussian_of_this_width():
    point = np.zeros((41, 41, 3), np.uint8)
    point[20, 20] = 255
    found = blur(point.astype(np.uint8), 1.0)[..., 0].astype(float)
    offsets = np.arange(-3, 4)
    row = np.exp(-(offsets**2) / 2)
    expected = 255 * np.outer(row, row) / row.sum() ** 2
    np.testing.assert_allclose(found[17:24, 17:24], expected, atol=1.0)
    np.testing.assert_array_equal(blur(np.full((9, 9, 3), 77, np.uint8), 2.0), 77)


def test_jpeg_keeps_colours_in_order_and_loses_more_with_less_quality():
    smooth = cv2.GaussianBlur(IMAGE, (0, 0), 2)
    errors = [np.abs(compress_jpeg(smooth, quality).astype(int) - smooth).mean() for quality in (95, 50, 5)]
    assert errors[0] < 3
    assert errors == sorted(errors)
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 0] = 200
    assert (compress_jpeg(red, 90)[..., 0] > 190).all()
    assert (compress_jpeg(red, 90)[..., 2] < 10).all()
