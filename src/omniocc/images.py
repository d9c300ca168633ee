"""Read images and masks that users hand over: as the sensor recorded them, never turned, by their true depth.

Every reader of image files, in any format and of any dataset, goes through this module.
"""

import io
import re
import stat
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image
from PIL.TiffImagePlugin import BITSPERSAMPLE, TiffImageFile

from omniocc.errors import DataError

KINDS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM", "JPEG2000")
LOSSLESS = ("PNG", "TIFF", "BMP", "PPM")
MOST_PIXELS = 150_000_000
"""Most pixels of an image; its header is read before it is decoded, so that a small file cannot fill the memory."""
MOST_BYTES = 8 * MOST_PIXELS
OPEN_BELOW = 2**14
"""Values that stay below leave open how deep the samples of 16 bits are: sensors have 10, 12, 14 or 16 bits."""
WHITE_16 = 2**16 - 1
ORIENTATION = 274
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
PPM_HEADER = re.compile(rb"P[2356]" + rb"(?:\s|#[^\n]*\n)+(\d+)" * 3)
"""Width, height and the value of white of a PPM or PGM file."""
Fits = Callable[[tuple[int, int]], object]
"""Raises an error if an image may not have a width and height, px; it is asked before the image is decoded."""

warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)  # MOST_PIXELS decides


@dataclass(frozen=True)
class Depth:
    """How many of the 16 bits of a sample an image uses, where its file does not say.

    Attributes:
        bits: 8 to 16; None: not known. Images of 8 bits do not ask.
        key: option that states them, for messages; empty: there is none.

    Raises:
        ValueError: naming the option, if the number is impossible.
    """

    bits: int | None = None
    key: str = ""

    def __post_init__(self) -> None:
        if self.bits is not None and not 8 <= self.bits <= 16:
            raise ValueError(f"{self.key or 'bits'} is {self.bits}; it must be 8 to 16, or null: not known")

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
    """Return the content of an image file; raise DataError, with the remedy, if there is no regular file to read."""
    try:
        status = path.stat()
        if stat.S_ISREG(status.st_mode) and status.st_size <= MOST_BYTES:  # a FIFO never answers, a device never ends
            return path.read_bytes()
    except FileNotFoundError as error:
        raise DataError(f"{path}: the file is missing{remedy and f'; {remedy}'}") from error
    except OSError as error:
        raise DataError(f"{path}: the file cannot be read ({error.strerror or error})") from error
    raise DataError(f"{path}: this is no regular file of at most {MOST_BYTES / 1e9:.1f} GB, so no image that is read")


def size_of(content: bytes, where: str) -> tuple[int, int]:
    """Return width and height, px, that the header of an encoded image states, as it was stored.

    Raises:
        DataError: beginning with `where`, if this is no image, or a larger one than is read.
    """
    return _header(_upright(content), where).size


def rgb_of(
    content: bytes, where: str, depth: Depth = UNKNOWN_DEPTH, fits: Fits | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Return an encoded image as RGB of 8 bits: alpha is dropped, no orientation tag is followed.

    Samples of 16 bits are scaled by the depth that the file states (sBIT of PNG, the header of PPM) or else `depth`.

    Raises:
        DataError: beginning with `where`, if the image is damaged, too large, of floats or of unknown depth.
        Exception: of `fits`, which is asked before the image is decoded.
    """
    content = _upright(content)
    image = _header(content, where)
    if fits is not None:
        fits(image.size)
    pixels = _decoded(content, image, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH, where)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise DataError(f"{where}: its values are of {pixels.dtype}; save it with 8 or 16 bits a channel")
    white = _stated_white(content, image, pixels)
    if white is None:
        white = 255 if pixels.dtype == np.uint8 else depth.white(int(pixels.max()), where)
    if white == WHITE_16:
        pixels = _decoded(content, image, cv2.IMREAD_COLOR, where)  # OpenCV's own rounding
    elif white != 255 or pixels.dtype != np.uint8:
        pixels = eight_bits(pixels, white)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def decoded(content: bytes, flags: int, where: str) -> np.ndarray:
    """Return an encoded image as OpenCV decodes it (flags: `cv2.IMREAD_...`), not turned; for ids and thumbnails.

    Raises:
        DataError: beginning with `where`, if it is damaged or too large.
    """
    content = _upright(content)
    return _decoded(content, _header(content, where), flags, where)


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
    content = _upright(content_of(path))
    image = _header(content, str(path))
    _check_size(image.size, size, path)
    if image.format not in LOSSLESS:
        grey = _decoded(content, image, cv2.IMREAD_GRAYSCALE, str(path))
        return grey > grey.max() // 2
    pixels = _decoded(content, image, cv2.IMREAD_UNCHANGED, str(path))
    pixels = pixels.reshape(*pixels.shape[:2], -1) != 0
    if pixels.shape[-1] < 4:
        return pixels.any(-1)
    seen, opaque = pixels[..., :3].any(-1), pixels[..., 3]
    if not (opaque.all() or not opaque.any() or np.array_equal(opaque, seen)):
        raise DataError(f"{path}: its transparency is not that of its colours; save the mask without transparency")
    return seen


def _mask_of_array(path: Path, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    if not path.is_file():
        raise DataError(f"{path}: there is no such file")
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # numpy has errors of its own
        raise DataError(f"{path}: the file is damaged ({error})") from error
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.dtype.kind not in "buif":
        raise DataError(f"{path}: a mask must be a matrix of numbers or truth values, of height x width")
    _check_size((values.shape[1], values.shape[0]), size, path)
    if np.isnan(values).any():
        raise DataError(f"{path}: the mask holds nan; it must be 0 where nothing is to be used")
    return np.asarray(values != 0)


def _check_size(found: tuple[int, int], wanted: tuple[int, int], path: Path) -> None:
    if found != wanted:
        raise DataError(f"{path} is {found[0]}x{found[1]} px but the image is {wanted[0]}x{wanted[1]} px")


def _header(content: bytes, where: str) -> Image.Image:
    """Return an image of which only the header has been read."""
    try:
        image = Image.open(io.BytesIO(content), formats=KINDS)
        large = image.width * image.height > MOST_PIXELS
    except Image.DecompressionBombError:
        large = True
    except Exception as error:  # Pillow's formats have errors of their own
        kinds = ", ".join(KINDS)
        raise DataError(f"{where}: the file is no image, or damaged or incomplete; {kinds} are read") from error
    if large:
        raise DataError(f"{where}: its header claims more than {MOST_PIXELS // 10**6} megapixels; it is not decoded")
    return image


def _decoded(content: bytes, image: Image.Image, flags: int, where: str) -> np.ndarray:
    try:
        if flags & cv2.IMREAD_COLOR and image.mode == "RGBA" and _tiff_bits(image) == 8:
            pixels = cv2.cvtColor(np.asarray(image), cv2.COLOR_RGBA2BGRA)  # OpenCV darkens colours by their alpha
            return pixels if flags == cv2.IMREAD_UNCHANGED else np.ascontiguousarray(pixels[..., :3])
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except Exception as error:  # OpenCV and the formats of Pillow have errors of their own
        raise DataError(f"{where}: the file is no image, or damaged or incomplete") from error
    if pixels is None:
        raise DataError(f"{where}: the file is no image, or damaged or incomplete")
    return pixels


def _upright(content: bytes) -> bytes:
    """Return a TIFF file whose orientation tag says 'as stored', for OpenCV turns it even when told not to; others."""
    if content[:4] not in TIFF:
        return content
    order: Literal["little", "big"] = "little" if content[:2] == b"II" else "big"

    def number(start: int, length: int) -> int:
        return int.from_bytes(content[start : start + length], order)

    word, count = (8, 8) if b"+" in content[:4] else (4, 2)  # BigTIFF has longer numbers
    step = 4 + 2 * word  # of an entry: tag, type, number of values, values
    first = number(word, word) + count
    stop = min(first + number(first - count, count) * step, len(content))
    for entry in range(first, stop, step):
        if number(entry, 2) == ORIENTATION:
            value = (3).to_bytes(2, order) + (1).to_bytes(word, order) + (1).to_bytes(2, order) + bytes(word - 2)
            return content[: entry + 2] + value + content[entry + step :]
    return content


def _stated_white(content: bytes, image: Image.Image, pixels: np.ndarray) -> int | None:
    """Return the value of white that a file states for its samples; None if it does not, or they are of 8 bits."""
    if header := PPM_HEADER.match(content):
        white = int(header[3])
        scaled = content[:2] in (b"P2", b"P3") and white < 256  # by OpenCV
        return None if scaled or white in (255, WHITE_16) else white
    if pixels.dtype != np.uint16:
        return None
    if 8 < _tiff_bits(image) < 16:
        return WHITE_16  # OpenCV shifts packed samples up
    bits = _significant_bits(content) if image.format == "PNG" else None
    if bits is None or not 0 < bits <= 16:
        return None
    # By the standard a writer scales samples up to 16 bits, whose lower bits then hold next to nothing; some do not.
    scaled_up = pixels.max() >= 2**bits or (pixels & (2 ** (16 - bits) - 1)).max() <= 1
    return WHITE_16 if scaled_up else 2**bits - 1


def _tiff_bits(image: Image.Image) -> int:
    """Return the number of bits of the samples of a TIFF file; 0 for other files."""
    return max(image.tag_v2.get(BITSPERSAMPLE, (1,))) if isinstance(image, TiffImageFile) else 0


def _significant_bits(content: bytes) -> int | None:
    """Return the largest number in the chunk sBIT of a PNG file, https://www.w3.org/TR/png-3/#11sBIT; None without."""
    at = 8
    while (kind := content[at + 4 : at + 8]) not in (b"IDAT", b""):
        length = int.from_bytes(content[at : at + 4], "big")
        if kind == b"sBIT":
            return max(content[at + 8 : at + 8 + length], default=None)
        at += 12 + length
    return None
