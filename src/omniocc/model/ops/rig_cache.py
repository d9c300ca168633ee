"""Cache of results that depend only on a rig and on sizes, limited by memory."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from functools import wraps
from threading import RLock
from typing import Any, Concatenate, ParamSpec, TypeVar

import torch
from torch import Tensor

from omniocc.camera import Rig
from omniocc.model.ops.static import is_static

LIMIT_BYTES = 2 << 30
"""Limit of the memory of all results: 40 rigs of the largest option (`omnimvs`) at preset=tiny."""
OVERHEAD_BYTES = 1 << 12
"""Assumed size of a rig's Python objects."""

P = ParamSpec("P")
R = TypeVar("R")


class RigCache:
    """Keep results of functions by rig; beyond the limit, drop those of the least recently used rig.

    Results may be large (the sampling matrices of a sweep) or small (a ray map), so the limit is in bytes. All results
    of a rig are dropped together.

    Args:
        limit_bytes: of all results; those of the newest rig are kept even if they are larger.
    """

    def __init__(self, limit_bytes: int = LIMIT_BYTES):
        self.limit_bytes = limit_bytes
        self._rigs: OrderedDict[Rig, dict[Hashable, Any]] = OrderedDict()
        self._bytes: dict[Rig, int] = {}
        self._lock = RLock()  # a result may be computed from others of this cache

    def __len__(self) -> int:
        return len(self._rigs)

    def clear(self) -> None:
        """Drop all results."""
        with self._lock:
            self._rigs.clear()
            self._bytes.clear()

    def get(self, rig: Rig, key: Hashable, compute: Callable[[], Any]) -> Any:
        """Return the result for a rig and a key, computed if it is not cached."""
        with self._lock:
            newest = next(reversed(self._rigs), rig)
            results = self._rigs.setdefault(rig, {})
            self._rigs.move_to_end(rig)
            # its results may have grown since the last was added (`Sampler.transpose`), but not in an export, which
            # cannot look into sparse matrices
            if newest != rig and not is_static():
                self._bytes[newest] = self._size_bytes(newest)
            if key not in results:
                with torch.inference_mode(False):  # training may use them as well
                    value = compute()  # may get other results of this rig
                results[key] = value
                self._bytes[rig] = self._size_bytes(rig)
                self._shrink()
            return results[key]

    def size_bytes(self) -> int:
        """Return the memory that all results take."""
        return sum(map(self._size_bytes, self._rigs))

    def _size_bytes(self, rig: Rig) -> int:
        return tensor_bytes((rig, self._rigs[rig])) + OVERHEAD_BYTES

    def _shrink(self) -> None:
        """Drop the least recently used rigs until the others fit into the limit."""
        while len(self._rigs) > 1 and sum(self._bytes.values()) > self.limit_bytes:
            oldest, _ = self._rigs.popitem(last=False)
            del self._bytes[oldest]


RIG_CACHE = RigCache()
"""The cache of this process."""


def once_per_rig(function: Callable[Concatenate[Rig, P], R]) -> Callable[Concatenate[Rig, P], R]:
    """Cache a function of a rig and other hashable arguments in `RIG_CACHE`; never write to its results."""

    @wraps(function)
    def cached(rig: Rig, *args: P.args, **kwargs: P.kwargs) -> R:
        key = (function, args, tuple(sorted(kwargs.items())))
        return RIG_CACHE.get(rig, key, lambda: function(rig, *args, **kwargs))

    return cached


def tensor_bytes(value: Any) -> int:
    """Return the memory of all tensors in nested containers and objects; shared memory counts once."""
    storages = {storage.data_ptr(): storage.nbytes() for storage in _storages(value)}
    return sum(storages.values())


def _storages(value: Any) -> Iterator[torch.UntypedStorage]:
    if isinstance(value, Tensor):
        sparse = value.layout == torch.sparse_csr
        parts = (value.crow_indices(), value.col_indices(), value.values()) if sparse else (value,)
        yield from (part.untyped_storage() for part in parts)
    elif isinstance(value, dict):
        for item in value.values():
            yield from _storages(item)
    elif isinstance(value, tuple | list):
        for item in value:
            yield from _storages(item)
    elif hasattr(value, "__dict__"):
        yield from _storages(vars(value))
