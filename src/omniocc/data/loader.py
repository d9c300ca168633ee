"""Loaders that never leave the training waiting: a batch comes by shared memory, else a pipe, or there is an error."""

import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from io import BytesIO
from multiprocessing.queues import Queue
from select import select
from threading import Thread
from types import TracebackType
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, get_worker_info

from omniocc.errors import LOADER_ENDED, DataError, first_line
from omniocc.parallel import limit_threads, start_fork_server

REMEDY = "enlarge it (Docker: --shm-size=8g), or read in the training process (data.num_workers=0)"


class Loader(DataLoader):
    """A `DataLoader` whose processes have one thread each; 0 reads in this process.

    Args:
        dataset: of the samples.
        batch_size: samples of a batch; None: each sample is a batch.
        num_workers: processes that read.
        collate: makes a batch of a list of samples, or of a sample.
        options: of a `DataLoader`.

    Iterating raises DataError, naming `data.num_workers`, when processes cannot start or one ends.
    """

    def __init__(
        self,
        dataset: Dataset,
        batch_size: int | None,
        num_workers: int,
        collate: Callable[[Any], Any],
        **options: Any,
    ):
        super().__init__(
            dataset,
            batch_size,
            num_workers=num_workers,
            collate_fn=partial(_collated, collate) if num_workers else collate,
            worker_init_fn=partial(_start_worker, os.getpid()),
            # a plain fork copies locks that other threads (W&B, OpenMP) hold: the loader would wait forever
            multiprocessing_context="forkserver" if num_workers else None,
            pin_memory=torch.cuda.is_available(),  # copies to the GPU run beside its work
            **options,
        )

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        """Return an iterator over batches; processes begin to read now."""
        if not self.num_workers:
            return super().__iter__()
        context: Any = self.multiprocessing_context
        start_fork_server()
        try:  # on trial what the loader will make, since it cannot clean up when it fails half-way
            _ = [context.Event(), *(context.Queue() for _ in range(self.num_workers + 1))]
            return self._read(super().__iter__())
        except OSError as error:  # of the semaphores, which lie in /dev/shm as well
            reason = f"loader processes cannot start, perhaps since /dev/shm is full ({error.strerror or error})"
            return _failing(DataError(f"data.num_workers={self.num_workers}: {reason}: {REMEDY}"))

    def _read(self, batches: Iterator[Any]) -> Iterator[Any]:
        try:
            yield from batches
        except RuntimeError as error:
            if not LOADER_ENDED.match(str(error)):
                raise
            raise DataError(
                f"data.num_workers={self.num_workers}: a loader process ended (out of memory?). Run the same command "
                "again with fewer of them; it continues where it stopped"
            ) from error


def _failing(error: Exception) -> Iterator[Any]:
    """Raise an error at the first batch: Lightning hides one that is raised before."""
    raise error
    yield


def _collated(collate: Callable[[Any], Any], samples: Any) -> Any:
    """Return a batch whose tensors lie in shared memory; where that is full, one that travels through a pipe.

    The thread that sends batches would move them to shared memory itself, but when it cannot, it drops the batch, and
    the training waits for ever.
    """
    batch = collate(samples)
    try:
        _Sharing(BytesIO()).dump(batch)
    except RuntimeError as error:
        worker = get_worker_info()
        return _InPipe(pickle.dumps(batch), worker.num_workers if worker else 0, first_line(error))
    return batch


class _Sharing(pickle.Pickler):
    """Moves every tensor to shared memory that an object holds."""

    def persistent_id(self, obj: Any) -> int | None:
        return None if not isinstance(obj, Tensor) else id(obj.share_memory_())


class _InPipe:
    """A batch that is pickled as its bytes and unpickled as itself."""

    def __init__(self, content: bytes, num_workers: int, reason: str):
        self.parts = content, num_workers, reason

    def __reduce__(self) -> tuple[Any, ...]:
        return _from_pipe, self.parts


def _from_pipe(content: bytes, num_workers: int, reason: str) -> Any:
    _tell_once(num_workers, reason.rpartition(": ")[2])
    return pickle.loads(content)


@cache
def _tell_once(num_workers: int, reason: str) -> None:
    print(
        f"data.num_workers={num_workers}: /dev/shm has no room for the batches of loader processes ({reason}), which "
        f"come through pipes, more slowly: {REMEDY}",
        flush=True,
    )


def _start_worker(trainer: int, _worker: int) -> None:
    limit_threads()
    Thread(target=_end_with, args=(trainer,), daemon=True).start()
    Queue._on_queue_feeder_error = staticmethod(_end)  # type: ignore[attr-defined]  # it would drop the batch
    sys.excepthook = _show_unless_left


def _show_unless_left(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Show an error of a thread, unless the training process has hung up on the one that hands over shared memory.

    It does so when Ctrl-C ends it in between. If a connection breaks otherwise, the training process raises the error.
    """
    if not issubclass(kind, (ConnectionError, EOFError)):
        sys.__excepthook__(kind, error, trace)


def _end(error: BaseException, _batch: Any) -> None:
    """End a loader process that cannot hand on a batch; the training process then raises an error."""
    print(f"a loader process cannot hand on what it has read: {first_line(error)}", flush=True)
    os._exit(1)


def _end_with(process: int) -> None:
    """End this process when another one ends; PyTorch asks for the parent only, which is the fork server."""
    with suppress(ProcessLookupError):  # it has ended already
        select([os.pidfd_open(process)], [], [])
    os._exit(1)
