import dataclasses
import io
import json

import numpy as np
import pytest
from fake_scene import fake_frame

from omniocc.data.store import codec
from omniocc.data.store.codec import interleave, pack, separate, unpack


def test_everything_but_colour_comes_back_within_two_millimetres():
    frame = fake_frame(seed=3, index=2)
    back = codec.decode_frame(codec.encode_frame(frame))
    assert back.time_s == frame.time_s
    assert back.boxes == frame.boxes
    for name in ("world_from_ego", "semantics", "lidar_labels"):
        np.testing.assert_array_equal(getattr(back, name), getattr(frame, name), err_msg=name)
        assert getattr(back, name).dtype == getattr(frame, name).dtype
    for name in ("range_m", "erp_range_m", "lidar_range_m"):
        expected, actual = getattr(frame, name), getattr(back, name)
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1 / 512 + 1e-6, err_msg=name)
        assert actual.dtype == np.float32


def test_points_come_back_in_another_order_within_four_millimetres():
    frame = fake_frame(seed=3, index=2)
    points_m, labels = codec.decode_points(codec.encode_points(frame.points_m, frame.point_labels))
    assert points_m.dtype == np.float32
    steps = (np.floor(frame.points_m.astype(np.float64) * 128) + 0.5) / 128
    assert np.abs(steps - frame.points_m).max() <= 1 / 256
    rows = sorted(map(tuple, np.column_stack([steps, frame.point_labels]).tolist()))
    assert sorted(map(tuple, np.column_stack([points_m, labels]).tolist())) == rows


def test_morton_codes():
    steps = np.array([[-32768, -32768, -32768], [-32767, -32768, -32768], [-32768, -32766, -32767], [32767, 0, -1]])
    codes = interleave(steps.astype(np.int16))
    assert codes.tolist()[:3] == [0, 0b001, 0b010100]
    everything = np.random.default_rng(0).integers(-32768, 32768, (1000, 3)).astype(np.int16)
    np.testing.assert_array_equal(separate(interleave(everything)), everything)
    np.testing.assert_array_equal(separate(codes), steps)


def test_range_codes():
    range_m = np.array([[np.nan, np.inf, 0.0, 0.001, 1.0, 1.00196, 255.99, 400.0]], dtype=np.float32)
    codes = codec.quantize_range(range_m)
    assert codes.tolist() == [[0, 65535, 1, 1, 256, 257, 65533, 65534]]
    np.testing.assert_array_equal(
        codec.restore_range(codes), [[np.nan, np.inf, 1 / 256, 1 / 256, 1.0, 257 / 256, 65533 / 256, 65534 / 256]]
    )
    with pytest.raises(ValueError, match=r"negative.*-1\.0 m"):
        codec.quantize_range(-np.ones((1, 1), dtype=np.float32))


def test_points_beyond_the_16_bit_range_are_left_out():
    points = np.array([[1, 2, 3], [255.9, 0, 0], [256.1, 0, 0], [0, -500, 0]], dtype=np.float32)
    back, labels = codec.decode_points(codec.encode_points(points, np.array([1, 2, 3, 4], dtype=np.uint8)))
    assert labels.tolist() == [1, 2]
    np.testing.assert_allclose(back, points[:2], atol=1 / 256, rtol=0)


def test_empty_arrays():
    back, labels = codec.decode_points(codec.encode_points(np.zeros((0, 3), np.float32), np.zeros(0, np.uint8)))
    assert back.shape == (0, 3)
    assert labels.shape == (0,)


def test_colour_stays_close_on_a_smooth_picture():
    rows, columns = np.mgrid[0:72, 0:128]
    image = np.stack([rows * 3, columns * 2, 255 - rows - columns], axis=-1).astype(np.uint8)
    back = codec.decode_image(codec.encode_image(image))
    assert np.abs(back.astype(int) - image).max() <= 6
    assert back[0, 0, 2] > back[0, 0, 0] + 200  # red and blue are not exchanged


def test_equal_frames_give_equal_bytes():
    assert codec.encode_frame(fake_frame(1, 1)) == codec.encode_frame(fake_frame(1, 1))


def test_numpy_numbers_in_boxes_are_written_as_plain_numbers():
    frame = fake_frame(1, 1)
    box = dataclasses.replace(frame.boxes[0], id=np.int32(5), yaw_rad=np.float32(0.5))
    blob = codec.encode_frame(dataclasses.replace(frame, boxes=(box,)))["frame.json"]
    assert json.load(io.BytesIO(blob))["boxes"][0]["yaw_rad"] == 0.5


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
