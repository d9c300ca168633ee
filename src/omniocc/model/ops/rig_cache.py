"""Results that depend on a rig and on sizes alone, kept until they take up too much memory."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from functools import wraps
from threading import RLock
from typing import Any, Concatenate, ParamSpec, TypeVar

import torch
from torch import Tensor

from omniocc.camera import Rig

LIMIT_BYTES = 2 << 30
"""Memory that the results for all rigs together may take: 40 rigs of the largest option (`omnimvs`) at preset=tiny."""
OVERHEAD_BYTES = 1 << 12
"""Assumed size of a rig's Python objects."""

P = ParamSpec("P")
R = TypeVar("R")


class RigCache:
    """Keep results of functions by rig; beyond the limit, forget those of the rig not used for longest.

    Results may be large (the sampling matrices of a sweep) or small (a ray map): the limit is on bytes, so that small
    ones serve hundreds of rigs. All results of a rig go together, as they are needed together.

    Args:
        limit_bytes: of all results; what the newest rig needs is kept even if it is more.
    """

    def __init__(self, limit_bytes: int = LIMIT_BYTES):
        self.limit_bytes = limit_bytes
        self._rigs: OrderedDict[Rig, dict[Hashable, Any]] = OrderedDict()
        self._lock = RLock()

    def __len__(self) -> int:
        return len(self._rigs)

    def clear(self) -> None:
        """Forget all results."""
        with self._lock:
            self._rigs.clear()

    def get(self, rig: Rig, key: Hashable, compute: Callable[[], Any]) -> Any:
        """Return the result for a rig and a key, computed if it is not there."""
        with self._lock:
            results = self._rigs.setdefault(rig, {})
            self._rigs.move_to_end(rig)
            if key not in results:
                value = compute()  # may get other results of this rig
                results[key] = value
                self._shrink()
            return results[key]

    def size_bytes(self) -> int:
        """Return the memory that all results take."""
        return sum(self._sizes())

    def _sizes(self) -> list[int]:
        return [tensor_bytes((rig, results)) + OVERHEAD_BYTES for rig, results in self._rigs.items()]

    def _shrink(self) -> None:
        """Forget the rigs not used for longest until the others fit into the limit."""
        sizes = self._sizes()  # of all: results may have grown since (`Sampler.transpose`)
        total = sum(sizes)
        for size in sizes[:-1]:
            if total <= self.limit_bytes:
                break
            self._rigs.popitem(last=False)
            total -= size


RIG_CACHE = RigCache()
"""The cache of this process."""


def once_per_rig(function: Callable[Concatenate[Rig, P], R]) -> Callable[Concatenate[Rig, P], R]:
    """Keep what a function of a rig and other hashable arguments returns in `RIG_CACHE`; never write to the result."""

    @wraps(function)
    def cached(rig: Rig, *args: P.args, **kwargs: P.kwargs) -> R:
        key = (function, args, tuple(sorted(kwargs.items())))
        return RIG_CACHE.get(rig, key, lambda: function(rig, *args, **kwargs))

    return cached


def tensor_bytes(value: Any) -> int:
    """Return the memory of all tensors in nested containers and objects; memory that they share counts once."""
    storages = {storage.data_ptr(): storage.nbytes() for storage in _storages(value)}
    return sum(storages.values())


def _storages(value: Any) -> Iterator[torch.UntypedStorage]:
    if isinstance(value, Tensor):
        dense = (
            (value.crow_indices(), value.col_indices(), value.values())
            if value.layout == torch.sparse_csr
            else (value,)
        )
        yield from (part.untyped_storage() for part in dense)
    elif isinstance(value, dict):
        for item in value.values():
            yield from _storages(item)
    elif isinstance(value, tuple | list):
        for item in value:
            yield from _storages(item)
    elif hasattr(value, "__dict__"):
        yield from _storages(vars(value))
