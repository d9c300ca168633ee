"""Progress of long work: a bar on a terminal, plain lines elsewhere, and a status file for the parent process.

A process that starts others names a file in the environment variable `STATUS_FILE` of each; they write their status to
it as one line of JSON (`Status`). This module imports nothing large: Hydra loads the launcher, and so this module, at
every start of a script.
"""

import contextlib
import json
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Literal

from omniocc.io import atomic_file

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

STATUS_FILE = "OMNIOCC_STATUS_FILE"
LINE_EVERY_S = 15.0
STATUS_EVERY_S = 1.0
MARK_EVERY_S, MARKS = 5.0, 12
"""The rate is measured over the last marks; they are set at least so far apart."""
BURST_S = 0.05
"""Units within this time were finished together."""


@dataclass(frozen=True)
class Status:
    """What a process is doing and how far it is.

    Attributes:
        state: whether it works, or waits for the result of another process.
        title: what is being done, or what is waited for.
        done: units done.
        total: units in all; 0 where nothing is counted.
        unit: name of the units, in the plural.
        rate_hz: units per second; 0 before the second.
        left_s: seconds left, None where unknown.
        text: further details, such as losses.
        results: folder of the figures, once there are any.
    """

    state: Literal["running", "waiting"]
    title: str
    done: int = 0
    total: int = 0
    unit: str = ""
    rate_hz: float = 0.0
    left_s: float | None = None
    text: str = ""
    results: str = ""

    @property
    def rate(self) -> str:
        """Return the rate in words: units per second, or seconds per unit where that is more than one."""
        if 0 < self.rate_hz < 1:
            return f"{1 / self.rate_hz:.2f} s each"
        return f"{self.rate_hz:.1f} {self.unit}/s"

    def __str__(self) -> str:
        if not self.total:
            return self.title
        rate = f", {self.rate}" if self.rate_hz else ""
        left = "" if self.left_s is None else f", {clock(self.left_s)} left"
        return f"{self.title}: {self.done}/{self.total} {self.unit}{rate}{left}  {self.text}".rstrip()


class Progress:
    """Counts units of work; shows how many are done, how fast, and the time left.

    Args:
        title: what is being done.
        total: units in all, with those done before.
        unit: what is counted, in the plural.
        done: units done before.
        finished: returns the number of units that all processes have done by now, where several share the work.
    """

    def __init__(self, title: str, total: int, unit: str = "frames", done: int = 0, finished: Callable[[], int] = int):
        self.title, self.total, self.unit, self.finished = title, total, unit, finished
        self._own, self._made, self._shown, self._others = done, 0, done, 0
        self._text = ""
        self._shown_s = time.monotonic()
        self._marks = deque([(self._shown_s, 0)], MARKS)  # times, and the units done since the beginning
        self._written_s = -STATUS_EVERY_S
        self._bar = _bar() if sys.stderr.isatty() else None
        if self._bar is not None:
            self._task = self._bar.add_task(title, total=total, completed=done, rate="", text="")

    @property
    def done(self) -> int:
        """Return the number of units done."""
        return self._own + self._others

    @property
    def rate_hz(self) -> float:
        """Return the units done per second in the last minute, without the first, which compile and fill caches.

        It is 0 before the second unit: the first one alone says little.
        """
        if self._made < 2:
            return 0.0
        begin_s, begun = self._marks[0]
        return (self._made + self._others - begun) / max(time.monotonic() - begin_s, 1e-9)

    @property
    def status(self) -> Status:
        """Return the present status, with the work of other processes."""
        self._others = max(self.finished() - self._own, 0)
        rate_hz = self.rate_hz
        left_s = (self.total - self.done) / rate_hz if rate_hz and self.done < self.total else None
        return Status("running", self.title, self.done, self.total, self.unit, rate_hz, left_s=left_s, text=self._text)

    def __enter__(self) -> "Progress":
        if self._bar is not None:
            self._bar.start()
        self._write()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
        elif kind is None and self.done > self._shown:
            self._line()
        self._write()

    def advance(self, count: int = 1, text: str = "") -> None:
        """Count units that are done: one just finished, or several that an earlier run had finished.

        `text` is shown beside the count, such as losses.
        """
        self._own, self._text = self._own + count, text
        self._made += count == 1
        self._mark()
        if self._bar is not None:
            status = self.status
            self._bar.update(self._task, completed=status.done, rate=status.rate, text=text)
        elif time.monotonic() - self._shown_s > LINE_EVERY_S:
            self._line()
        if time.monotonic() - self._written_s > STATUS_EVERY_S:
            self._write()

    def message(self, text: str) -> None:
        """Print a line between the counts."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False)
        else:
            print(text, file=sys.stderr, flush=True)

    def wait(self, text: str) -> None:
        """Report what is waited for, until the next count."""
        self.message(text)
        write_status(Status("waiting", text))
        self._written_s = -STATUS_EVERY_S

    def _mark(self) -> None:
        now_s, made = time.monotonic(), self._made + self._others
        since_s = now_s - self._marks[-1][0]
        if len(self._marks) == 1 or since_s > MARK_EVERY_S:
            self._marks.append((now_s, made))
            if len(self._marks) == 3 and self._marks[0][1] == 0:
                self._marks.popleft()
        elif since_s < BURST_S:
            self._marks[-1] = (self._marks[-1][0], made)

    def _line(self) -> None:
        status = self.status
        self._shown, self._shown_s = status.done, time.monotonic()
        print(status, file=sys.stderr, flush=True)

    def _write(self) -> None:
        self._written_s = time.monotonic()
        if STATUS_FILE in os.environ:
            write_status(self.status)


@contextlib.contextmanager
def show_waiting(title: str, reason: str) -> Iterator[None]:
    """Print and report that the work `title` waits inside this block for another process."""
    print(f"{title} {reason}", flush=True)
    write_status(Status("waiting", f"{title} {reason}"))
    yield
    write_status(Status("running", title))


def write_status(status: Status) -> None:
    """Write the status atomically to the file that the environment names; do nothing if it names none.

    A status that cannot be written is skipped: the work itself must not fail for it.
    """
    if STATUS_FILE not in os.environ:
        return
    path = Path(os.environ[STATUS_FILE])
    if path.parent.is_dir():
        with contextlib.suppress(OSError), atomic_file(path, flush=False) as file:
            file.write(json.dumps(asdict(status)).encode())


def read_status(path: Path) -> Status | None:
    """Return the last status that a process has written to its file, None before the first."""
    try:
        return Status(**json.loads(path.read_text("utf-8")))
    except FileNotFoundError:
        return None


def clock(seconds: float) -> str:
    """Return a duration as minutes and seconds, as hours and minutes, or as days."""
    if seconds < 3600:
        return f"{int(seconds // 60)}:{int(seconds % 60):02d} min"
    if seconds < 86400:
        return f"{int(seconds // 3600)}:{int(seconds % 3600 // 60):02d} h"
    return f"{seconds / 86400:.1f} days"


def _bar() -> "Bar":
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    return Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}"),
        console=Console(stderr=True),
    )
