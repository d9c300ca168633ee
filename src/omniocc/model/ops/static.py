"""Networks whose shapes and branches do not depend on the data, as exported programs need them."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

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


def is_static() -> bool:
    """Return whether shapes must not depend on the data."""
    return _static.get()
