"""Progress of rendering: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

LINE_EVERY_S = 15.0


class FrameProgress:
    """Counts frames; shows how many, how fast and how long it will still take.

    Args:
        title: what is being made.
        total: frames to be made in this run.
        finished: how many of them are there by now, whoever made them, where several processes share the work.
    """

    def __init__(self, title: str, total: int, finished: Callable[[], int] = int):
        self.title = title
        self.total = total
        self.finished = finished
        self._own = self._made = self._shown = self._others = 0
        self._began_s = self._shown_s = time.monotonic()
        self._bar: Progress | None = None
        if sys.stderr.isatty():
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
            )
            bar = Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True))
            self._task = bar.add_task(title, total=total, rate="")
            self._bar = bar

    @property
    def done(self) -> int:
        """Frames that are there."""
        return self._own + self._others

    @property
    def rate_hz(self) -> float:
        """Frames made per second since the beginning."""
        return (self._made + self._others) / max(time.monotonic() - self._began_s, 1e-9)

    def __enter__(self) -> "FrameProgress":
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
        elif kind is None and self.done > self._shown:
            self._line()

    def advance(self, frames: int = 1) -> None:
        """Count frames that are done: one just made, or all that an interrupted run has left of a scene."""
        self._own += frames
        self._made += frames == 1
        if self._bar is not None:
            self._ask_others()
            self._bar.update(self._task, completed=self.done, rate=f"{self.rate_hz:.1f} frames/s")
        elif time.monotonic() - self._shown_s > LINE_EVERY_S:
            self._line()

    def message(self, text: str) -> None:
        """A line between the counts."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False)
        else:
            print(text, file=sys.stderr, flush=True)

    def _ask_others(self) -> None:
        self._others = max(self.finished() - self._own, 0)

    def _line(self) -> None:
        self._ask_others()
        self._shown, self._shown_s = self.done, time.monotonic()
        left_s = (self.total - self.done) / max(self.rate_hz, 1e-9)
        eta = f", {clock(left_s)} left" if self._made and self.done < self.total else ""
        print(
            f"{self.title}: {self.done}/{self.total} frames, {self.rate_hz:.1f} frames/s{eta}",
            file=sys.stderr,
            flush=True,
        )


def clock(seconds: float) -> str:
    """Minutes and seconds, or hours and minutes, or days and hours."""
    if seconds < 3600:
        return f"{int(seconds // 60)}:{int(seconds % 60):02d} min"
    if seconds < 86400:
        return f"{int(seconds // 3600)}:{int(seconds % 3600 // 60):02d} h"
    return f"{seconds / 86400:.1f} days"
