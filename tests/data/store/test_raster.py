import numpy as np
import pytest

from omniocc.data.store.raster import pack, unpack


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (37, 53)])
def test_every_value_comes_back(dtype, shape):
    pixels = np.random.default_rng(1).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)
    pixels[0, 0] = np.iinfo(dtype).max
    back = unpack(pack(pixels))
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, pixels)


def test_a_plane_costs_next_to_nothing():
    rows, columns = np.mgrid[0:200, 0:300].astype(np.uint16)
    assert len(pack(500 + 7 * rows + 11 * columns)) < 500  # of 120 kB


def test_sixteen_bits_wrap_around():
    pixels = np.array([[0, 65535, 0], [65535, 0, 65535], [1, 32768, 32767]], dtype=np.uint16)
    np.testing.assert_array_equal(unpack(pack(pixels)), pixels)
