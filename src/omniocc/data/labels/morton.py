"""Morton codes: the bits of three coordinates interleaved, so that points near in space are near in order."""

import numpy as np

# shift and mask of each step: 16 bits are spread to every third place in four halvings
_STEPS = tuple(
    (np.uint64(shift), np.uint64(mask))
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    )
)


def interleave(steps: np.ndarray) -> np.ndarray:
    """Return the codes (P,) uint64, 48 bits each, of coordinates (P, 3) int16."""
    code = np.zeros(len(steps), dtype=np.uint64)
    for axis in range(3):
        bits = (steps[:, axis].astype(np.int32) + 32768).astype(np.uint64)
        for shift, mask in _STEPS:
            bits = (bits | (bits << shift)) & mask
        code |= bits << np.uint64(axis)
    return code


def separate(codes: np.ndarray) -> np.ndarray:
    """Return the coordinates of codes, the inverse of `interleave`."""
    steps = np.empty((len(codes), 3), dtype=np.int16)
    masks = [np.uint64(0xFFFF), *(mask for _, mask in _STEPS)]
    for axis in range(3):
        bits = (codes >> np.uint64(axis)) & masks[-1]
        for (shift, _), mask in zip(_STEPS[::-1], masks[-2::-1], strict=True):
            bits = (bits | (bits >> shift)) & mask
        steps[:, axis] = bits.astype(np.int32) - 32768
    return steps
