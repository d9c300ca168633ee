"""Images of messages are what the sensor saw, whatever the encoding."""

import io
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image

from omniocc.camera import MEI, Equidistant, Pinhole
from omniocc.errors import DataError
from omniocc.extras.recorders.bag import is_rectified
from omniocc.extras.recorders.messages import camera_of, image_of
from omniocc.images import Depth

CAMERA = Equidistant(8, 6, 3.0, (3.5, 2.5), 95.0)
KEY = "recorder.image_bits"
RAMP = np.linspace(0, 4095, 48).round().astype(np.uint16).reshape(6, 8)
"""Values of a sensor of 12 bits, from black to white."""


def raw(encoding, pixels, is_bigendian=0, step=None):
    height, width = pixels.shape[:2]
    rows = np.frombuffer(pixels.tobytes(), np.uint8).reshape(height, -1)
    padded = np.concatenate([rows, np.full((height, 6), 77, np.uint8)], axis=1)
    size = {"height": height, "width": width, "step": step or padded.shape[1]}
    return SimpleNamespace(encoding=encoding, is_bigendian=is_bigendian, data=padded.reshape(-1), **size)


def compressed(content, kind="png"):
    return SimpleNamespace(format=kind, data=np.frombuffer(content, np.uint8))


def read(message, bits=None):
    return image_of(message, "log.bag, /front", CAMERA, Depth(bits, KEY))


@pytest.mark.parametrize("is_bigendian", [0, 1])
def test_words_are_read_by_their_depth(is_bigendian):
    order = ">u2" if is_bigendian else "<u2"
    grey = (RAMP * (255 / 4095)).round().astype(np.uint8)
    for message in (raw("mono12", RAMP.astype(order), is_bigendian), raw("mono16", RAMP.astype(order), is_bigendian)):
        assert np.array_equal(read(message, 12), np.dstack([grey] * 3))
    coloured = np.dstack([RAMP, RAMP // 2, RAMP // 4])
    for encoding, pixels in (("rgb16", coloured), ("bgr16", coloured[..., ::-1])):
        found = read(raw(encoding, pixels.astype(order), is_bigendian), 12)
        assert np.abs(found - coloured * (255 / 4095)).max() <= 0.5
    bayer = read(raw("bayer_rggb12", RAMP.astype(order), is_bigendian))
    assert np.array_equal(bayer, cv2.cvtColor(grey, cv2.COLOR_BayerRGGB2RGB))
    full = (RAMP.astype(np.uint32) * 65535 // 4095).astype(order)
    assert np.abs(read(raw("mono16", full, is_bigendian))[..., 0] - grey.astype(int)).max() <= 1


def test_words_of_unknown_or_wrong_depth_are_refused():
    with pytest.raises(DataError, match=rf"log\.bag, /front: .* reach 4095.*set {KEY}=12"):
        read(raw("mono16", RAMP))
    with pytest.raises(DataError, match=rf"log\.bag, /front \(mono16; png\): .* reach 4095.*set {KEY}=12"):
        read(compressed(cv2.imencode(".png", RAMP)[1].tobytes(), "mono16; png"))
    with pytest.raises(DataError, match=r"its largest value is 4095, more than mono10=10 allows"):
        read(raw("mono10", RAMP))
    with pytest.raises(DataError, match=r"bytes are too few.*8x6 px of mono12"):  # packed
        read(raw("mono12", RAMP.astype(np.uint8)))
    for size in ({"height": 0}, {"width": 0}):
        message = SimpleNamespace(**vars(raw("mono16", RAMP)) | size)
        with pytest.raises(DataError, match=r"bytes are too few"):
            read(message)
    with pytest.raises(DataError, match=r"the encoding 16UC1 cannot be read"):  # depth images have it
        read(raw("16UC1", RAMP))


def test_compressed_images_are_not_turned():
    exif = Image.Exif()
    exif[0x0112] = 3
    pixels = np.zeros((48, 64, 3), np.uint8)
    pixels[:24] = 255
    for kind in ("JPEG", "PNG"):
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, kind, exif=exif)
        assert np.abs(read(compressed(file.getvalue())).astype(int) - pixels).max() <= 3


def test_compressed_images_must_be_whole_and_those_of_the_camera():
    content = cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    for damaged in (b"", b"text", content[:40]):
        with pytest.raises(DataError, match=r"log\.bag, /front \(png\): the file is no image"):
            read(compressed(damaged))
    other = cv2.imencode(".png", np.zeros((48, 48, 3), np.uint8))[1].tobytes()
    with pytest.raises(DataError, match=r"the image is 48x48 px, but its camera is calibrated for 8x6 px"):
        read(compressed(other))


def test_names_in_messages_are_shown_in_one_line():
    for message in (raw("<b>\n" * 10**5, RAMP), compressed(b"text", "<b>\n" * 10**5)):
        with pytest.raises(DataError) as caught:
            read(message)
        assert len(str(caught.value)) < 1000
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("encoding", "size"), [("yuv422", (6, 7, 2)), ("yuv422_yuy2", (6, 1, 2))])
def test_sizes_that_an_encoding_cannot_have_are_refused(encoding, size):
    words = rf"log\.bag, /front: an image of {size[1]}x{size[0]} px cannot have the encoding {encoding}"
    with pytest.raises(DataError, match=words):
        read(raw(encoding, np.zeros(size, np.uint8)))


def info(turn=(1, 0, 0, 0, 1, 0, 0, 0, 1)):
    roi = SimpleNamespace(x_offset=0, y_offset=0)
    numbers = {"k": [50, 0, 32, 0, 50, 18, 0, 0, 1], "d": [-0.3, 0.08, 0, 0, 0], "r": turn}
    numbers["p"] = [44, 0, 33, 0, 0, 45, 17, 0, 0, 0, 1, 0]
    sizes = {"width": 64, "height": 36, "binning_x": 0, "binning_y": 0}
    return SimpleNamespace(distortion_model="plumb_bob", roi=roi, **numbers, **sizes)


def test_rectified_images_have_the_projection_and_no_distortion():
    assert isinstance(camera_of(info(), "here"), MEI)
    assert camera_of(info(), "here", rectified=True) == Pinhole(64, 36, (44.0, 45.0), (33.0, 17.0))
    with pytest.raises(DataError, match=r"^here: the images are rectified and turned \(R\); give rig=<file> instead$"):
        camera_of(info([0, -1, 0, 1, 0, 0, 0, 0, 1]), "here", rectified=True)


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [("/front/image_rect_color/compressed", True), ("/image_rect", True), ("/rect/image_raw", False)],
)
def test_the_names_of_rectified_topics(topic, rectified):
    assert is_rectified(topic) == rectified
