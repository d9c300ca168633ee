"""Compilation of functions by numba."""

from collections.abc import Callable

from numba import njit


def compiled(function: Callable) -> Callable:
    """Compile at the first call; keep the result on disk if a folder is writable.

    Numba's cache does not notice changes in other files: functions that call each other belong into one.
    """
    try:
        return njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # neither the package's folder nor the user's cache folder is writable
        return njit(nogil=True, error_model="numpy")(function)
