"""One job of a multirun: a process, a log file of what it prints, and a status file of what it has done."""

import ctypes
import os
import re
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from omniocc.progress import STATUS_FILE, Status, read_status

TAIL_BYTES = 4096
LINES_OF_A_FAILURE = 12
PR_SET_PDEATHSIG = 1


class Job:
    """A process that is started later, in a process group of its own.

    Args:
        label: how it is called in messages.
        command: program and arguments.
        log: file that gets everything it prints; an old one is replaced. The status file lies beside it.
    """

    def __init__(self, label: str, command: Sequence[str], log: Path):
        self.label = label
        self.command = list(command)
        self.log = log
        self.status_file = log.with_suffix(".status.json")
        self.process: subprocess.Popen[bytes] | None = None
        self.began_s = self.elapsed_s = 0.0

    def start(self, environment: dict[str, str]) -> None:
        """Begin."""
        self.status_file.unlink(missing_ok=True)
        with self.log.open("wb") as output:
            self.process = subprocess.Popen(
                self.command,
                env={**os.environ, **environment, STATUS_FILE: str(self.status_file)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=die_with_parent,
            )
        self.began_s = time.monotonic()

    @property
    def code(self) -> int | None:
        """Exit code; None before the end."""
        if self.process is None:
            return None
        code = self.process.poll()
        if code is not None and not self.elapsed_s:
            self.elapsed_s = self.age_s
        return code

    @property
    def age_s(self) -> float:
        """Since it began."""
        return time.monotonic() - self.began_s

    @property
    def running(self) -> bool:
        """Started and not at its end."""
        return self.process is not None and self.code is None

    @property
    def waiting(self) -> bool:
        """Whether it waits for what another job makes."""
        status = self.status
        return self.running and status is not None and status.state == "waiting"

    @property
    def status(self) -> Status | None:
        """What it has reported last, None before its first report."""
        return read_status(self.status_file)

    def last_lines(self, count: int = LINES_OF_A_FAILURE) -> list[str]:
        """Its last lines that are not empty."""
        if not self.log.exists():
            return []
        with self.log.open("rb") as file:
            file.seek(max(0, self.log.stat().st_size - TAIL_BYTES))
            text = file.read().decode(errors="replace")
        return [line.rstrip() for line in text.splitlines() if line.strip()][-count:]

    def interrupt(self, number: int) -> None:
        """Send a signal to the process and its children."""
        if self.process is not None and self.running:
            os.killpg(self.process.pid, number)


def die_with_parent() -> None:
    """In the child: be told to end when the parent does, however that happens (Linux)."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def label_of(overrides: Sequence[str]) -> str:
    """What tells a job from others: `+ablation=mono seed=1` is `mono seed=1`."""
    return " ".join(override.removeprefix("+ablation=") for override in overrides)


def file_name(label: str, number: int) -> str:
    """A log file's name."""
    return f"{number:03d}-{re.sub(r'[^A-Za-z0-9_.=-]+', '_', label)[:80]}.log"
