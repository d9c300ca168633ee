"""How this process gets memory from the system."""

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
LARGEST_BLOCK, LARGEST_REST = 2**30, 2**31 - 1


def keep_freed_memory() -> None:
    """Tells glibc to keep what is freed: tensors of every step would be given back, fetched and zeroed again.

    Blocks up to 1 GiB; larger ones, and other C libraries, are left alone. The process holds on to its peak.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)
        mallopt(M_TRIM_THRESHOLD, LARGEST_REST)
