"""Make scenes in several processes, each scene in exactly one, even if other runs work on the same folder."""

import contextlib
import json
import multiprocessing
import os
import pickle
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait
from pathlib import Path
from queue import Empty
from signal import SIG_BLOCK, SIG_IGN, SIG_SETMASK, SIGINT, pthread_sigmask, signal
from typing import Any, TypeVar

from filelock import FileLock

import omniocc
from omniocc.errors import DataError
from omniocc.io import atomic_write
from omniocc.lock import Held, acquire
from omniocc.progress import Progress

Report = Callable[[int], None]
Work = Callable[[Path, Report], None]
"""A function that makes one scene folder and reports every frame; reporting raises `Stopped` when work has to end."""


Item = TypeVar("Item")
Result = TypeVar("Result")


class Stopped(Exception):  # noqa: N818
    """Raised to end after the current frame: another scene failed or the user pressed Ctrl-C."""


def usable_cores() -> int:
    """Return the number of cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def make_scenes(work: Work, folders: Sequence[Path], workers: int, progress: Progress) -> None:
    """Run `work` for every folder; scenes that another run is making come last and are waited for.

    `workers` processes share the folders; 0 works in this one. `work` must be picklable; `progress` advances frame by
    frame.

    Raises:
        DataError: when the disk refuses, or a worker process was killed.
        RuntimeError: from `work`.
    """
    if workers == 0:
        for report_wait in (None, progress.wait):
            folders = [folder for folder in folders if not _make(work, progress.advance, folder, report_wait)]
        return
    context = process_context(work)
    with worker_environment(needs_main=b"__main__" in pickle.dumps(work)):
        events, stop = context.Queue(), context.Event()
        pool = ProcessPoolExecutor(min(workers, len(folders)), context, _start_worker, (work, events, stop))
        try:
            for waits in (False, True):
                jobs = {folder: pool.submit(_make_in_worker, folder, waits) for folder in folders}
                _follow(list(jobs.values()), events, progress)
                folders = [folder for folder, job in jobs.items() if not job.result()]
        except BrokenProcessPool as error:
            raise DataError(
                f"{folders[0].parent}: a process was killed (out of memory?). Run the same command again, "
                "perhaps with fewer workers; it continues where it stopped"
            ) from error
        finally:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)


def mapped(work: Callable[[Item], Result], items: Sequence[Item], workers: int) -> Iterator[Result]:
    """Yield `work` of every item in order, from `workers` processes; without workers, or for one item, from this one.

    `work` must be picklable.

    Raises:
        DataError: when a process is killed.
    """
    if workers == 0 or len(items) < 2:
        yield from map(work, items)
        return
    with (
        worker_environment(needs_main=False),
        ProcessPoolExecutor(min(workers, len(items)), process_context(work), limit_threads) as pool,
    ):
        try:
            yield from pool.map(work, items)
        except BrokenProcessPool as error:
            raise DataError("a process was killed (out of memory?). Run the same command with fewer workers") from error


def process_context(work: Callable[..., Any]) -> Any:
    """Return the context of new processes; with `forkserver` these are copies of one that has the imports of `work`."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([getattr(work, "func", work).__module__])
    start_fork_server()
    return context


def start_fork_server() -> None:
    """Start the process whose copies `forkserver` makes, such that Ctrl-C never reaches it or them.

    A terminal sends Ctrl-C to all processes of a command. The parent alone answers it, and then ends the others.
    """
    resource_tracker.ensure_running()  # first, since it unblocks the signal
    before = pthread_sigmask(SIG_BLOCK, {SIGINT})
    try:
        forkserver.ensure_running()
    finally:
        pthread_sigmask(SIG_SETMASK, before)


@contextlib.contextmanager
def worker_environment(needs_main: bool) -> Iterator[None]:
    """Let processes started inside use one thread each in numerical libraries, and find this package.

    With `needs_main` they import the running script too, which takes seconds in each of them if it imports Lightning.
    """
    paths = [str(Path(omniocc.__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    changes = dict.fromkeys(threads, "1") | {"PYTHONPATH": os.pathsep.join(paths)}
    script = sys.modules["__main__"]
    names = () if needs_main else ("__file__", "__spec__")
    hidden = {name: value for name in names if (value := getattr(script, name, None)) is not None}
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    vars(script).update(dict.fromkeys(hidden))
    try:
        yield
    finally:
        vars(script).update(hidden)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def limit_threads(_worker: int = 0) -> None:
    """Limit numerical libraries in this process to one thread."""
    import cv2
    import torch

    cv2.setNumThreads(1)
    torch.set_num_threads(1)


def _follow(jobs: list[Future], events: Any, progress: Progress) -> None:
    while True:
        done = all(job.done() for job in jobs)  # asked first: what finished jobs report is in the queue by then
        failed = [job for job in jobs if job.done() and not job.cancelled() and job.exception() is not None]
        with contextlib.suppress(Empty):
            while True:
                event = events.get(timeout=0.0 if done else 0.1)
                progress.wait(event) if isinstance(event, str) else progress.advance(event)
        if failed:
            raise failed[0].exception() or AssertionError
        if done:
            return


def _start_worker(work: Work, events: Any, stop: Any) -> None:
    global _work, _events, _stop
    _work, _events, _stop = work, events, stop
    signal(SIGINT, SIG_IGN)  # the parent gets Ctrl-C and sets the stop event
    limit_threads()
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_exit_after, args=(parent.sentinel,), daemon=True).start()


def _exit_after(parent: int) -> None:
    wait([parent])
    os._exit(1)


def _make_in_worker(folder: Path, waits: bool) -> bool:
    return _make(_work, _report, folder, _events.put if waits else None)


def _report(frames: int) -> None:
    _events.put(frames)
    if _stop.is_set():
        raise Stopped


def _make(work: Work, report: Report, folder: Path, report_wait: Callable[[str], Any] | None) -> bool:
    """Make a scene and return True; if another run holds it, return False, or call `report_wait` and wait."""
    try:
        lock = _lock(folder, report_wait)
    except Held:
        return False
    try:
        work(folder, report)
    except Stopped:
        return False
    finally:
        lock.release()
    return True


def _lock(folder: Path, report_wait: Callable[[str], Any] | None) -> FileLock:
    locks = folder.parent / ".locks"
    path, owner = locks / f"{folder.name}.lock", locks / f"{folder.name}.owner"
    try:
        lock = acquire(path)
    except Held:
        if report_wait is None:
            raise
        report_wait(f"another process {_owner(owner)} makes {folder.name}, waiting")
        lock = acquire(path, wait=True)
    atomic_write(owner, json.dumps({"pid": os.getpid(), "host": socket.gethostname()}))
    return lock


def _owner(path: Path) -> str:
    try:
        facts = json.loads(path.read_text("utf-8"))
        return f"(pid {facts['pid']} on {facts['host']})"
    except (OSError, ValueError):  # the other process is writing it
        return "(unknown)"


_work: Any = None
_events: Any = None
_stop: Any = None
