"""Networks whose shapes and branches do not depend on the data: exported programs, and streams on a GPU."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar

import torch

_static = ContextVar("static", default=False)


@contextmanager
def static_shapes() -> Iterator[None]:
    """Let options that select voxels or points compute all of them first: equal results, but slower.

    Batches must have one sample.
    """
    token = _static.set(True)
    try:
        yield
    finally:
        _static.reset(token)


def static_on_gpu(device: torch.device) -> AbstractContextManager[None]:
    """Return `static_shapes()` for a GPU, where the size of a selection is known only after all work before it.

    Elsewhere it returns a context that does nothing.
    """
    return static_shapes() if device.type == "cuda" else nullcontext()


def is_static() -> bool:
    """Return whether shapes must not depend on the data."""
    return _static.get()
