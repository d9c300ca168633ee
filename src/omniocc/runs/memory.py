"""Reuse of the memory that this process has freed."""

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
LARGEST_BLOCK, LARGEST_REST = 2**30, 2**31 - 1


def keep_freed_memory() -> None:
    """Let glibc reuse freed blocks of up to 1 GiB, since returning tensors to the system after every step is slow.

    The process then keeps its peak memory. Other C libraries are not changed.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)
        mallopt(M_TRIM_THRESHOLD, LARGEST_REST)
