"""Images are what the sensor saw: not turned, of known depth; what is no image gives one line, in little memory."""

import io
import os
import re
import resource
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from omniocc.errors import DataError
from omniocc.images import Depth, content_of, decoded, read_mask, rgb_of, size_of

SRC = Path(__file__).parents[1] / "src"
RNG = np.random.default_rng(0)
RAMP = np.linspace(0, 4095, 48).round().astype(np.uint16).reshape(6, 8)
"""Values of a sensor of 12 bits, from black to white."""


def scene(height: int = 48, width: int = 64) -> np.ndarray:
    """Return an RGB image whose corner at the top left is red, all else black."""
    image = np.zeros((height, width, 3), np.uint8)
    image[: height // 2, : width // 2] = (255, 0, 0)
    return image


def saved(image: np.ndarray, kind: str, **options) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, kind, **options)
    return file.getvalue()


def encoded(suffix: str, image: np.ndarray) -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png_of_size(width: int, height: int) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


def png_with_sbit(pixels: np.ndarray, bits: int) -> bytes:
    plain = encoded(".png", pixels)
    return plain[:33] + chunk(b"sBIT", bytes([bits])) + plain[33:]  # behind the header


def tiff(samples: bytes, width: int, height: int, bits: int, orientation: int, big: bool) -> bytes:
    """Return a grey TIFF file, in BigTIFF or the classic format, most significant byte first."""
    word, count = (8, 8) if big else (4, 2)
    tags = {256: width, 257: height, 258: bits, 259: 1, 262: 1, 273: 0, 274: orientation, 277: 1, 278: height, 279: 0}
    start = 2 * word + count + len(tags) * (4 + 2 * word) + word
    tags |= {273: start, 279: len(samples)}
    rows = b"".join(
        struct.pack(">HH", tag, 3) + (1).to_bytes(word, "big") + struct.pack(">H", value) + bytes(word - 2)
        for tag, value in tags.items()
    )
    header = b"MM\0+\0\x08\0\0" if big else b"MM\0*"
    return header + (2 * word).to_bytes(word, "big") + len(tags).to_bytes(count, "big") + rows + bytes(word) + samples


@pytest.mark.parametrize("orientation", [3, 6])  # half a turn; a quarter, which swaps width and height
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP", "TIFF"])
def test_no_orientation_tag_turns_an_image(kind, orientation, tmp_path):
    exif = Image.Exif()
    exif[0x0112] = orientation
    options = {"tiffinfo": {274: orientation}} if kind == "TIFF" else {"exif": exif}
    content = saved(scene(), kind, **options)
    assert size_of(content, "a") == (64, 48)
    found = rgb_of(content, "a").astype(int)
    assert found.shape == (48, 64, 3)
    assert np.abs(found - scene())[8:16, 8:24].max() <= 3  # JPEG and WebP lose a little
    assert found[32:].max() <= 3
    assert found[:, 40:].max() <= 3
    assert decoded(content, cv2.IMREAD_REDUCED_GRAYSCALE_2, "a").shape == (24, 32)
    path = tmp_path / "mask"
    path.write_bytes(content)
    assert np.array_equal(read_mask(path, (64, 48))[8:40, 8:24], scene()[8:40, 8:24, 0] > 0)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("orientation", [3, 6])
def test_no_orientation_tag_turns_a_tiff_of_16_bits(orientation, big):
    values = np.arange(60_000, 63_600, 300).astype(">u2").reshape(3, 4)
    found = rgb_of(tiff(values.tobytes(), 4, 3, 16, orientation, big), "a")[..., 0]
    assert np.array_equal(found, values >> 8)


def test_images_of_8_bits_are_what_opencv_reads():
    image = RNG.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    for suffix in (".png", ".jpg", ".bmp", ".tif", ".webp", ".ppm"):
        content = encoded(suffix, image)
        expected = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert np.array_equal(rgb_of(content, "a"), expected[..., ::-1]), suffix


def test_other_kinds_of_pixels():
    grey = RNG.integers(0, 256, (6, 8)).astype(np.uint8)
    assert np.array_equal(rgb_of(saved(grey, "PNG"), "a"), np.dstack([grey] * 3))
    alpha = np.dstack([scene(), np.full((48, 64), 7, np.uint8)])
    for kind in ("PNG", "TIFF"):  # what shines through is no part of the image
        assert np.array_equal(rgb_of(saved(alpha, kind), "a"), scene()), kind
    palette = io.BytesIO()
    Image.fromarray(scene()).quantize(2).save(palette, "PNG")
    assert np.array_equal(rgb_of(palette.getvalue(), "a"), scene())
    printed = io.BytesIO()
    Image.fromarray(scene()).convert("CMYK").save(printed, "JPEG", quality=100)
    assert np.abs(rgb_of(printed.getvalue(), "a").astype(int) - scene())[::40, ::40].max() <= 3
    for values in (grey.astype(np.float32) / 255, grey.astype(np.int32)):
        with pytest.raises(DataError, match=r"^a: "):
            rgb_of(encoded(".tif", np.dstack([values] * 3)), "a")


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_the_depth_of_16_bits_must_be_known(suffix):
    content = encoded(suffix, RAMP)
    with pytest.raises(DataError, match=r"^a: .* reach 4095.*10, 12, 14 or 16 bits; set recorder\.image_bits=12"):
        rgb_of(content, "a", Depth(None, "recorder.image_bits"))
    with pytest.raises(DataError, match=r"reach 4095.*save it with 8 bits"):
        rgb_of(content, "a")
    found = rgb_of(content, "a", Depth(12, "image_bits"))
    assert np.array_equal(found, np.dstack([(RAMP * (255 / 4095)).round()] * 3))
    assert rgb_of(content, "a", Depth(16, "image_bits")).max() == 15
    with pytest.raises(DataError, match=r"^a: its largest value is 4095, more than image_bits=10 allows"):
        rgb_of(content, "a", Depth(10, "image_bits"))
    with pytest.raises(ValueError, match=r"image_bits is 20; it must be 8 to 16"):
        Depth(20, "image_bits")


def test_16_bits_that_are_used_and_black_images_need_no_key():
    values = RNG.integers(0, 65536, (6, 8, 3)).astype(np.uint16)
    for suffix, pixels in ((".png", values), (".tif", values), (".ppm", values), (".tif", values[..., 0])):
        content = encoded(suffix, pixels)
        expected = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert np.array_equal(rgb_of(content, "a"), expected[..., ::-1]), suffix
    assert rgb_of(encoded(".png", np.zeros((6, 8), np.uint16)), "a").max() == 0
    levels = RNG.integers(0, 256, (6, 8)).astype(np.uint8)
    for depth in (Depth(), Depth(12, "image_bits")):  # images of 8 bits do not ask
        assert np.array_equal(rgb_of(encoded(".png", levels), "a", depth)[..., 0], levels)


def test_a_png_states_its_depth():
    expected = (RAMP * (255 / 4095)).round()
    assert np.array_equal(rgb_of(png_with_sbit(RAMP, 12), "a")[..., 0], expected)
    scaled_up = RAMP << 4 | RAMP >> 8  # as the standard asks for
    assert np.abs(rgb_of(png_with_sbit(scaled_up, 12), "a")[..., 0] - expected).max() <= 1
    dark = RAMP // 32 << 4
    assert rgb_of(png_with_sbit(dark, 12), "a").max() == dark.max() >> 8
    assert rgb_of(png_with_sbit(RAMP, 16), "a").max() == 15


@pytest.mark.parametrize(
    "content",
    [
        b"P5\n# by hand\n3 1\n4095\n\x00\x00\x07\xff\x0f\xff",
        b"P2\n3 1\n4095\n0 2047 4095\n",
        b"P5 3 1 15\n\x00\x07\x0f",
        b"P2 3 1 15\n0 7 15\n",
        tiff(bytes.fromhex("0007fffff0"), 3, 1, 12, 1, False),
    ],
)
def test_other_files_that_state_their_depth(content):
    found = rgb_of(content, "a", Depth(16, "image_bits"))[0, :, 1].astype(int)
    assert found[0] == 0
    assert found[2] == 255
    assert abs(found[1] - 127) <= 8  # 7 of 15 is 119


def test_a_header_is_read_before_the_image(tmp_path):
    jpeg = bytearray(encoded(".jpg", scene()))
    frame = jpeg.index(b"\xff\xc0") + 5
    jpeg[frame : frame + 4] = b"\xff\xff\xff\xff"
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for bomb in (png_of_size(49_000, 49_000), bytes(jpeg), png_of_size(13_000, 13_000), b"P6 60000 60000 255\n"):
        for read in (lambda: rgb_of(bomb, "a"), lambda: size_of(bomb, "a"), lambda: decoded(bomb, 0, "a")):  # noqa: B023
            with pytest.raises(DataError, match=r"^a: its header claims more than 150 megapixels"):
                read()
        path = tmp_path / "mask.png"
        path.write_bytes(bomb)
        with pytest.raises(DataError, match="megapixels"):
            read_mask(path, (64, 48))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB
    sizes = []
    rgb_of(encoded(".png", scene()), "a", fits=sizes.append)
    assert sizes == [(64, 48)]
    with pytest.raises(ZeroDivisionError):  # asked before a damaged rest is found
        rgb_of(png_of_size(64, 48)[:60], "a", fits=lambda size: 1 // 0)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".webp", ".ppm"])
def test_damaged_images_are_named(suffix):
    whole = encoded(suffix, RNG.integers(0, 256, (20, 30, 3)).astype(np.uint8))
    for content in (b"", b"no image\n", whole[:20], whole[: len(whole) // 2], whole[:4]):
        with pytest.raises(DataError, match=r"^a: the file is no image, or damaged or incomplete"):
            rgb_of(content, "a")
    for width, height in ((0, 5), (5, 0)):
        with pytest.raises(DataError, match=r"^a: the file is no image"):
            rgb_of(png_of_size(width, height), "a")


def test_what_is_no_file_is_not_opened(tmp_path):
    fifo = tmp_path / "fifo.png"
    os.mkfifo(fifo)
    (tmp_path / "huge.png").touch()
    os.truncate(tmp_path / "huge.png", 10**12)
    for path, reason in (
        (fifo, " cannot be read: it is a pipe"),
        (tmp_path, " cannot be read: it is a folder"),
        (Path("/dev/zero"), " cannot be read: it is a device"),
        (tmp_path / "huge.png", ": the file has 1,000,000,000,000 bytes, more than can be read"),
    ):
        with pytest.raises(DataError, match=f"^{re.escape(str(path))}{reason}"):
            content_of(path)
        with pytest.raises(DataError, match=re.escape(str(path))):
            read_mask(path, (64, 48))
    with pytest.raises(DataError, match=r"none\.png: the file is missing; unpack it"):
        content_of(tmp_path / "none.png", "unpack it")


SEEN = np.zeros((48, 64), bool)
SEEN[5:20, 10:50] = True


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("ones.png", saved(SEEN.astype(np.uint8), "PNG")),
        ("white.png", saved(SEEN.astype(np.uint8) * 255, "PNG")),
        ("dim.bmp", encoded(".bmp", SEEN.astype(np.uint8) * 100)),
        ("bits.png", saved(SEEN, "PNG")),
        ("words.png", encoded(".png", SEEN.astype(np.uint16))),
        ("words.tif", encoded(".tif", SEEN.astype(np.uint16) * 65535)),
        ("blue.png", saved(SEEN[..., None] * np.array([0, 0, 1], np.uint8), "PNG")),
        ("opaque.png", saved(np.dstack([SEEN] * 3 + [SEEN | True]).astype(np.uint8), "PNG")),
        ("alpha.png", saved(SEEN[..., None] * np.array([255] * 4, np.uint8), "PNG")),
        ("alpha.tif", saved(SEEN[..., None] * np.array([255] * 4, np.uint8), "TIFF")),
        ("photo.jpg", encoded(".jpg", SEEN.astype(np.uint8) * 255)),
    ],
)
def test_a_mask_is_what_is_not_0(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert np.array_equal(read_mask(path, (64, 48)), SEEN)
    with pytest.raises(DataError, match=rf"{name} is 64x48 px but the image is 48x64 px"):
        read_mask(path, (48, 64))


def test_a_mask_with_a_palette(tmp_path):
    image = Image.fromarray(SEEN.astype(np.uint8) + 1, "P")
    image.putpalette([9, 9, 9, 0, 0, 0, 0, 0, 2])
    image.save(tmp_path / "mask.png")
    assert np.array_equal(read_mask(tmp_path / "mask.png", (64, 48)), SEEN)


def test_a_mask_whose_transparency_says_something_else_is_refused(tmp_path):
    image = np.full((48, 64, 4), 255, np.uint8)
    image[..., 3] = SEEN
    Image.fromarray(image).save(tmp_path / "mask.png")
    with pytest.raises(DataError, match=r"mask\.png: its transparency.*save the mask without"):
        read_mask(tmp_path / "mask.png", (64, 48))


def test_masks_as_arrays(tmp_path):
    path = tmp_path / "mask.npy"
    for values in (SEEN, SEEN.astype(np.uint8), SEEN * 0.5, SEEN.astype(np.int64) * -3):
        np.save(path, values)
        assert np.array_equal(read_mask(path, (64, 48)), SEEN)
    wrong = {
        "matrix": [SEEN[..., None], SEEN.astype("U1"), SEEN * 1j],
        "nan": [np.where(SEEN, np.nan, 1)],
        "damaged": [np.array([[None]])],
        "is 3x2 px but the image is 64x48 px": [np.ones((2, 3))],
    }
    for message, arrays in wrong.items():
        for values in arrays:
            np.save(path, values)
            with pytest.raises(DataError, match=rf"mask\.npy.* {message}|mask\.npy.*{message}"):
                read_mask(path, (64, 48))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DataError, match=r"mask\.npy: the file is damaged"):
        read_mask(path, (64, 48))


OWN = {
    "omniocc/images.py",
    "omniocc/data/store/codec.py",
    "omniocc/data/augment/degrade.py",
    "omniocc/report/write.py",
    "omniocc/extras/robustness/evaluation.py",
}
"""Files that may decode images: the reader of users' files; what this program itself has written or holds in memory."""


def test_nothing_else_reads_images():
    decoding = re.compile(r"\b(imread\w*|imdecode\w*|VideoCapture|Image\.open|from PIL|import PIL|imageio)\b")
    found = {str(path.relative_to(SRC)) for path in SRC.rglob("*.py") if decoding.search(path.read_text())}
    assert found == OWN
