"""Compilation of functions by numba, and threads that run them."""

import itertools
import threading
from collections.abc import Callable

from numba import njit

UNITS_PER_TASK = 2000
"""Approximate number of rays or samples of one task of a thread; less work is not worth a thread."""


def compiled(function: Callable) -> Callable:
    """Compile at the first call; keep the result on disk if a folder is writable.

    Numba's cache does not notice changes in other files: functions that call each other belong into one.
    """
    try:
        return njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # neither the package's folder nor the user's cache folder is writable
        return njit(nogil=True, error_model="numpy")(function)


def run_in_threads(work: Callable[[int, int], object], groups: int, units: int) -> None:
    """Call `work(first, last)` for ranges that cover 0 .. groups-1, in as many threads as torch may use.

    `units` is about how many rays or samples are computed in all.
    """
    import torch  # the processes that render do without

    threads = torch.get_num_threads()
    tasks = max(1, min(groups, units // UNITS_PER_TASK, 8 * threads))
    ranges = list(itertools.pairwise(groups * i // tasks for i in range(tasks + 1)))
    failed: list[BaseException] = []

    def run() -> None:
        try:
            while not failed:
                work(*ranges.pop())  # the interpreter's lock makes pop atomic; the kernels release the lock
        except IndexError:
            return
        except BaseException as error:  # raised again below, in the calling thread
            failed.append(error)

    helpers = [threading.Thread(target=run) for _ in range(min(threads, tasks) - 1)]
    for helper in helpers:
        helper.start()
    run()
    for helper in helpers:
        helper.join()
    if failed:
        raise failed[0]
