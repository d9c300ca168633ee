"""How this process keeps the memory that it has freed."""

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
LARGEST_BLOCK, LARGEST_REST = 2**30, 2**31 - 1


def keep_freed_memory() -> None:
    """Tell glibc to keep what is freed: else tensors of every step would be given back, fetched and zeroed again.

    This holds for blocks up to 1 GiB; other C libraries are left alone. The process keeps its peak of memory.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)
        mallopt(M_TRIM_THRESHOLD, LARGEST_REST)
