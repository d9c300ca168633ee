"""Zstandard frames of members, unpacked only up to the size that is expected."""

import zstandard


def decompress(blob: bytes, limit_bytes: int) -> bytes:
    """Return the content of a frame that states its size.

    Raises:
        ValueError: if it would be larger than the limit; nothing is unpacked.
        zstandard.ZstdError: if the bytes are no such frame.
    """
    size = zstandard.frame_content_size(blob)
    if size > limit_bytes:
        raise ValueError(f"it unpacks to {size:,} bytes, at most {limit_bytes:,} are expected")
    return zstandard.ZstdDecompressor().decompress(blob)
