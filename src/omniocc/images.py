"""Read images and masks that users hand over: as the sensor recorded them, never turned, by their true depth.

Every reader of image files, in any format and of any dataset, goes through this module.
"""

import io
import re
import warnings
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image

from omniocc.errors import DataError, UserError, first_line
from omniocc.io import read_bytes

KINDS = ("PNG", "JPEG", "BMP", "WEBP", "PPM", "JPEG2000")
"""Formats beside TIFF, by their names in Pillow, which reads their headers."""
LOSSLESS = ("PNG", "TIFF", "BMP", "PPM")
MOST_PIXELS = 150_000_000
"""Most pixels of an image; its header is read before it is decoded, so that a small file cannot fill the memory."""
MOST_BYTES = 8 * MOST_PIXELS
OPEN_BELOW = 2**14
"""Values that stay below leave open how deep the samples of 16 bits are: sensors have 10, 12, 14 or 16 bits."""
WHITE_16 = 2**16 - 1
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
TIFF_WIDTH, TIFF_HEIGHT, TIFF_BITS, TIFF_ORIENTATION, TIFF_SAMPLES, TIFF_EXTRA = 256, 257, 258, 274, 277, 338
TIFF_LENGTHS = {1: 1, 3: 2, 4: 4, 16: 8}
"""Bytes of a whole number by its type."""
PPM_HEADER = re.compile(rb"P[2356]" + rb"(?:\s|#[^\n]*\n)+(\d+)" * 3)
"""Width, height and the value of white of a PPM or PGM file."""
Fits = Callable[[tuple[int, int]], object]
"""Raises an error if an image may not have a width and height, px; it is asked before the image is decoded."""

warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)  # MOST_PIXELS decides


class Header(NamedTuple):
    """What the header of an image file states.

    Attributes:
        kind: format.
        size: width and height as stored, px.
        bits: of the samples of a TIFF file; 0 for other files.
        samples: of each pixel of a TIFF file; 0 for other files.
    """

    kind: str
    size: tuple[int, int]
    bits: int = 0
    samples: int = 0


@dataclass(frozen=True)
class Depth:
    """How many of the 16 bits of a sample an image uses, where its file does not say.

    Attributes:
        bits: 8 to 16; None: not known. Images of 8 bits do not ask.
        key: option that states them, for messages; empty: there is none.

    Raises:
        UserError: naming the option, if the number is impossible.
    """

    bits: int | None = None
    key: str = ""

    def __post_init__(self) -> None:
        if self.bits is not None and not 8 <= self.bits <= 16:
            raise UserError(f"{self.key or 'bits'} is {self.bits}; it must be 8 to 16, or null: not known")

    def white(self, largest: int, where: str) -> int:
        """Return the value of white in an image of 16 bits whose largest value is `largest`.

        Raises:
            DataError: beginning with `where`, if that value is above white, or is so small that the depth is open.
        """
        if self.bits is not None and largest >= 2**self.bits:
            raise DataError(f"{where}: its largest value is {largest}, more than {self.key}={self.bits} allows")
        if self.bits is None and 0 < largest < OPEN_BELOW:
            depths = "10, 12, 14 or 16 bits"
            remedy = f"set {self.key}=12, or how many there are" if self.key else "save it with 8 bits a channel"
            raise DataError(f"{where}: its samples of 16 bits reach {largest}: they may have {depths}; {remedy}")
        return WHITE_16 if self.bits is None else 2**self.bits - 1


UNKNOWN_DEPTH = Depth()


def content_of(path: Path, remedy: str = "") -> bytes:
    """Return the content of an image file; raise DataError as `read_bytes`, and if it is longer than images are."""
    return read_bytes(path, remedy, MOST_BYTES)


def size_of(content: bytes, where: str) -> tuple[int, int]:
    """Return width and height, px, that the header of an encoded image states, as it was stored.

    Raises:
        DataError: beginning with `where`, if this is no image, or a larger one than is read.
    """
    return _opened(content, where)[1].size


def rgb_of(
    content: bytes, where: str, depth: Depth = UNKNOWN_DEPTH, fits: Fits | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Return an encoded image as RGB of 8 bits: alpha is dropped, no orientation tag is followed.

    Samples of 16 bits are scaled by the depth that the file states (sBIT of PNG, the header of PPM) or else `depth`.

    Raises:
        DataError: beginning with `where`, if the image is damaged, too large, of floats or of unknown depth.
        Exception: of `fits`, which is asked before the image is decoded.
    """
    content, header = _opened(content, where)
    if fits is not None:
        fits(header.size)
    pixels = _decoded(content, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH, where)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise DataError(f"{where}: its values are of {pixels.dtype}; save it with 8 or 16 bits a channel")
    white = _stated_white(content, header, pixels)
    if white is None:
        white = 255 if pixels.dtype == np.uint8 else depth.white(int(pixels.max()), where)
    if white == WHITE_16 and header.samples < 3:  # as libpng and OpenCV; libtiff rounds colours
        pixels = (pixels >> 8).astype(np.uint8)
    elif white != 255 or pixels.dtype != np.uint8:
        pixels = eight_bits(pixels, white)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def decoded(content: bytes, flags: int, where: str) -> np.ndarray:
    """Return an encoded image as OpenCV decodes it (flags: `cv2.IMREAD_...`), not turned; for ids and thumbnails.

    Raises:
        DataError: beginning with `where`, if it is damaged or too large.
    """
    return _decoded(_opened(content, where)[0], flags, where)


def eight_bits(pixels: np.ndarray, white: int) -> np.ndarray:
    """Return samples of up to 16 bits as uint8, rounded, so that `white` becomes 255; so does what is above."""
    scaled = (pixels.astype(np.uint32) * 255 + white // 2) // white
    return np.minimum(scaled, 255).astype(np.uint8)


def read_mask(path: Path, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """Return where a mask is not 0, in any colour; in formats with loss, where it is nearer to its largest value.

    Args:
        path: an image of any depth, or a .npy file of a matrix of numbers or truth values.
        size: width and height that it must have, px.

    Raises:
        DataError: naming the file, if it is no mask, of another size, or transparent where its colours are not 0.
    """
    if path.suffix.lower() == ".npy":
        return _mask_of_array(path, size)
    content, header = _opened(content_of(path), str(path))
    _check_size(header.size, size, path)
    if header.kind not in LOSSLESS:
        grey = _decoded(content, cv2.IMREAD_GRAYSCALE, str(path))
        return grey > grey.max() // 2
    pixels = _decoded(content, cv2.IMREAD_UNCHANGED, str(path))
    pixels = pixels.reshape(*pixels.shape[:2], -1) != 0
    if pixels.shape[-1] < 4:
        return pixels.any(-1)
    seen, opaque = pixels[..., :3].any(-1), pixels[..., 3]
    if not (opaque.all() or not opaque.any() or np.array_equal(opaque, seen)):
        raise DataError(f"{path}: its transparency is not that of its colours; save the mask without transparency")
    return seen


def _mask_of_array(path: Path, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    content = content_of(path)
    try:
        values = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # numpy has errors of its own
        raise DataError(f"{path}: the file is damaged ({first_line(error)})") from error
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.dtype.kind not in "buif":
        raise DataError(f"{path}: a mask must be a matrix of numbers or truth values, of height x width")
    _check_size((values.shape[1], values.shape[0]), size, path)
    if np.isnan(values).any():
        raise DataError(f"{path}: the mask holds nan; it must be 0 where nothing is to be used")
    return np.asarray(values != 0)


def _check_size(found: tuple[int, int], wanted: tuple[int, int], path: Path) -> None:
    if found != wanted:
        raise DataError(f"{path} is {found[0]}x{found[1]} px but the image is {wanted[0]}x{wanted[1]} px")


def _opened(content: bytes, where: str) -> tuple[bytes, Header]:
    """Return an encoded image as it is to be decoded, and its header; raise DataError if it is none, or too large."""
    try:
        if content[:4] in TIFF:
            content, header = _tiff(content)
        else:
            image = Image.open(io.BytesIO(content), formats=KINDS)  # reads no pixels
            header = Header(str(image.format), image.size)
        pixels = header.size[0] * header.size[1]
    except Image.DecompressionBombError:
        header, pixels = None, MOST_PIXELS + 1
    except Exception as error:  # Pillow's formats have errors of their own
        raise _damaged(where) from error
    if pixels > MOST_PIXELS:
        raise DataError(f"{where}: its header claims more than {MOST_PIXELS // 10**6} megapixels; it is not decoded")
    if header is None or not pixels:
        raise _damaged(where)
    return content, header


def _decoded(content: bytes, flags: int, where: str) -> np.ndarray:
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise _damaged(where) from error
    if pixels is None:
        raise _damaged(where)
    return pixels


def _damaged(where: str) -> DataError:
    return DataError(f"{where}: the file is no image, or damaged or incomplete ({', '.join(KINDS)} and TIFF are read)")


def _tiff(content: bytes) -> tuple[bytes, Header]:
    """Return a TIFF file that says 'not turned, colours not to be multiplied by alpha', and its header.

    OpenCV follows these tags even when it is told not to. https://www.itu.int/itudoc/itu-t/com16/tiff-fx/docs/tiff6.pdf
    """
    order: Literal["little", "big"] = "little" if content[:2] == b"II" else "big"
    word, count = (8, 8) if b"+" in content[:4] else (4, 2)  # BigTIFF has longer numbers
    step = 4 + 2 * word  # of an entry: tag, type, number of values, values or where they are

    def number(start: int, length: int) -> int:
        return int.from_bytes(content[start : start + length], order)

    changed, values = bytearray(content), defaultdict[int, int](int)
    first = number(word, word) + count
    for entry in range(first, min(first + number(first - count, count) * step, len(content)), step):
        tag, kind, at = number(entry, 2), number(entry + 2, 2), entry + 4 + word
        length, values_count = TIFF_LENGTHS.get(kind, 2), number(entry + 4, word)
        values[tag] = number(number(at, word) if values_count * length > word else at, length)
        if tag == TIFF_ORIENTATION or (tag == TIFF_EXTRA and values_count == 1):
            changed[at : at + length] = (1).to_bytes(length, order)  # as stored; colours are multiplied already
    size = values[TIFF_WIDTH], values[TIFF_HEIGHT]
    return bytes(changed), Header("TIFF", size, values[TIFF_BITS], values[TIFF_SAMPLES])


def _stated_white(content: bytes, header: Header, pixels: np.ndarray) -> int | None:
    """Return the value of white that a file states for its samples; None if it states none.

    None is also the answer for white of 255 or 65535 in a header of PPM, for samples that OpenCV has scaled, and for
    other files of 8 bits.
    """
    if match := PPM_HEADER.match(content):
        white = int(match[3])
        scaled = content[:2] in (b"P2", b"P3") and white < 256  # by OpenCV
        return None if scaled or white in (255, WHITE_16) else white
    if pixels.dtype != np.uint16:
        return None
    if 8 < header.bits < 16:
        return WHITE_16  # OpenCV shifts packed samples up
    bits = _significant_bits(content) if header.kind == "PNG" else None
    if bits is None or not 0 < bits <= 16:
        return None
    # By the standard a writer scales samples up to 16 bits, whose lower bits then hold next to nothing; some do not.
    scaled_up = pixels.max() >= 2**bits or (pixels & (2 ** (16 - bits) - 1)).max() <= 1
    return WHITE_16 if scaled_up else 2**bits - 1


def _significant_bits(content: bytes) -> int | None:
    """Return the largest number in the chunk sBIT of a PNG file, https://www.w3.org/TR/png-3/#11sBIT; None without."""
    at = 8
    while (kind := content[at + 4 : at + 8]) not in (b"IDAT", b""):
        length = int.from_bytes(content[at : at + 4], "big")
        if kind == b"sBIT":
            return max(content[at + 8 : at + 8 + length], default=None)
        at += 12 + length
    return None
