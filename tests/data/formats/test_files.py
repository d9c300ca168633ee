import cv2
import numpy as np
import pytest
from PIL import Image

from omniocc.data.formats.files import (
    check_root,
    class_table,
    decode,
    image_size,
    map_classes,
    read_array,
    read_image,
    read_npz,
    read_text,
    scaled_size,
)
from omniocc.errors import DataError


def test_numbers_without_header(tmp_path):
    path = tmp_path / "scan.bin"
    values = np.arange(15, dtype="<f4").reshape(3, 5)
    path.write_bytes(values.tobytes())
    np.testing.assert_array_equal(read_array(path, "<f4", (-1, 5)), values)
    np.testing.assert_array_equal(read_array(path, "<f4", (3, 5)), values)
    assert read_array(path, "<f4", (-1, 5)).flags.writeable
    with pytest.raises(DataError, match=r"scan\.bin: the file has 60 bytes instead of 80; it is damaged"):
        read_array(path, "<f4", (4, 5))
    with pytest.raises(DataError, match=r"scan\.bin: the file has 60 bytes instead of a multiple of 16"):
        read_array(path, "<f4", (-1, 4))
    with pytest.raises(DataError, match=r"none\.bin: the file is missing; get it"):
        read_array(tmp_path / "none.bin", "<f4", (-1, 5), "get it")
    with pytest.raises(DataError, match="cannot be read"):
        read_array(tmp_path, "<f4", (-1, 5))


def test_arrays_of_an_npz(tmp_path):
    path = tmp_path / "labels.npz"
    np.savez(path, a=np.ones((2, 3)), b=np.zeros(4))
    assert read_npz(path, {"a": (2, 3)})["a"].sum() == 6
    for shapes, message in (
        ({"c": (1,)}, "has no array 'c'"),
        ({"b": (5,)}, r"'b' has the shape \(4,\) instead of \(5,\)"),
    ):
        with pytest.raises(DataError, match=message):
            read_npz(path, shapes)
    content = path.read_bytes()
    for wrong in (content[: len(content) // 2], b"", b"text"):
        path.write_bytes(wrong)
        with pytest.raises(DataError, match=r"labels\.npz: the file is damaged"):
            read_npz(path, {"a": (2, 3)})


def test_a_pickle_in_an_npz_is_not_opened(tmp_path):
    path = tmp_path / "labels.npz"
    np.savez(path, a=np.array([{"a": 1}], dtype=object))
    with pytest.raises(DataError, match="damaged"):
        read_npz(path, {"a": (1,)})


def test_images_are_scaled_and_must_be_those_of_the_calibration(tmp_path):
    path = tmp_path / "front.png"
    image = np.zeros((40, 80, 3), np.uint8)
    image[:, :40] = (255, 0, 0)  # blue, as OpenCV orders colours
    cv2.imwrite(str(path), image)
    found = read_image(path, (80, 40), (40, 24))
    assert found.shape == (24, 40, 3)
    assert found[5, 5].tolist() == [0, 0, 255]
    with pytest.raises(DataError, match=r"front\.png: the image has 80x40 px, but its calibration is for 90x40 px"):
        read_image(path, (90, 40), (40, 24))
    for wrong in (b"", path.read_bytes()[:60]):
        path.write_bytes(wrong)
        with pytest.raises(DataError, match=r"front\.png: the file is no image, or damaged"):
            read_image(path, None, (40, 16))
    cv2.imwrite(str(path), image[:1, :1])
    with pytest.raises(DataError, match=r"front\.png: the image has 1x1 px, but its calibration is for 40x16 px, or a"):
        read_image(path, None, (40, 16))
    assert scaled_size(1600, 900, 256) == (256, 144)
    assert scaled_size(1241, 376, 256) == scaled_size(1226, 370, 256) == (256, 80)


def test_images_of_datasets_are_not_turned_and_never_too_dark(tmp_path):
    path, exif = tmp_path / "front.png", Image.Exif()
    image = np.zeros((40, 80, 3), np.uint8)
    image[:20, :40] = 200
    exif[0x0112] = 6
    Image.fromarray(image).save(path, exif=exif)
    assert image_size(path) == (80, 40)
    assert np.array_equal(read_image(path, (80, 40), (80, 40)), image)
    assert np.array_equal(decode(path, cv2.IMREAD_UNCHANGED)[..., 2], image[..., 0])
    cv2.imwrite(str(path), np.full((40, 80), 4000, np.uint16))
    with pytest.raises(DataError, match=r"front\.png: its samples of 16 bits reach 4000.*save it with 8 bits"):
        read_image(path, (80, 40), (80, 40))


def test_class_ids_outside_of_the_table_are_named(tmp_path):
    table = class_table({0: 0, 10: 1, 252: 1})
    assert map_classes(np.array([0, 252, 10]), table, tmp_path).tolist() == [0, 1, 1]
    with pytest.raises(DataError, match=r"class ids \[11, 300\] are not in"):
        map_classes(np.array([0, 300, 11, 10]), table, tmp_path)


def test_texts_and_roots(tmp_path):
    (tmp_path / "calib.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="it is no text"):
        read_text(tmp_path / "calib.txt")
    assert check_root(str(tmp_path), ["calib.txt"], "unpack it") == tmp_path
    with pytest.raises(DataError, match=r"samples not found, it holds calib\.txt; unpack it"):
        check_root(str(tmp_path), ["samples"], "unpack it")
    with pytest.raises(DataError, match=r"it is no folder; unpack it"):
        check_root(str(tmp_path / "nowhere"), ["samples"], "unpack it")
