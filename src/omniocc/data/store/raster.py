"""Lossless storage of integer images: a header of height and width (two uint16), then the pixels under zstd.

16-bit pixels are replaced by their difference from a plane through the left, upper and upper left neighbours; all low
bytes come before all high bytes. Ranges of a street become a third smaller than PNG, seven times as fast.
"""

from itertools import pairwise

import numpy as np
import zstandard

from omniocc.data.store.zstd import decompress

_LEVEL = 1
_HEADER = np.dtype("<u2")
_HEADER_BYTES = 4
MAX_PIXELS = 2**26
"""More than any camera or panorama has; 8192 x 8192."""


def pack(pixels: np.ndarray) -> bytes:
    """Return an image (H, W) uint8 or uint16 as bytes; equal pixels give equal bytes."""
    body = pixels if pixels.dtype == np.uint8 else _differences(pixels)
    header = np.array(pixels.shape, dtype=_HEADER).tobytes()
    return zstandard.ZstdCompressor(level=_LEVEL).compress(header + np.ascontiguousarray(body).tobytes())


def unpack(blob: bytes, limit_px: int = MAX_PIXELS) -> np.ndarray:
    """Return the image that bytes hold, the inverse of `pack`; it may have at most this many pixels.

    Raises:
        ValueError: if it has more, or the bytes hold neither 8 nor 16 bits per pixel.
        zstandard.ZstdError: if they are no zstd frame.
    """
    content = np.frombuffer(decompress(blob, 2 * min(limit_px, MAX_PIXELS) + _HEADER_BYTES), dtype=np.uint8)
    height, width = content[:4].view(_HEADER).tolist()
    body = content[4:]
    if len(body) == height * width:
        return body.reshape(height, width).copy()
    low, high = body.reshape(2, height, width).astype(np.uint16)
    residual = low | high << np.uint16(8)
    residual = (residual >> np.uint16(1)) ^ -(residual & np.uint16(1))
    pixels = np.add.accumulate(residual, axis=1, dtype=np.uint16)
    for above, row in pairwise(pixels):  # three times as fast as accumulating along the columns
        row += above
    return pixels


def _differences(pixels: np.ndarray) -> np.ndarray:
    """Return the low, then the high bytes (2, H, W) of second differences modulo 2**16.

    Differences near zero become small numbers: 0, -1, 1, -2 become 0, 1, 2, 3.
    """
    across = pixels.copy()
    across[:, 1:] -= pixels[:, :-1]
    residual = across.copy()
    residual[1:] -= across[:-1]
    signed = residual.view(np.int16)
    folded = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    return np.stack([folded & 0xFF, folded >> 8]).astype(np.uint8)
