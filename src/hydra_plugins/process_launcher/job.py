"""One job of a multirun: a process, a log file of its output, and a status file of its progress."""

import contextlib
import os
import re
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from omniocc.progress import STATUS_FILE, Status, read_status
from omniocc.runs.fork_server import end_with_parent

TAIL_BYTES = 4096
"""Size of the end of a log in which its last lines are looked for."""
FAILURE_LINES = 12
"""Number of lines of its log that are shown of a failed job."""


class Process(Protocol):
    """A process that was requested and may not have begun yet, such as `subprocess.Popen`."""

    @property
    def pid(self) -> int | None:
        """Return its id, which is also the id of its process group; None before it begins."""
        ...

    def poll(self) -> int | None:
        """Return the exit code; None before the end."""
        ...


Starter = Callable[[Sequence[str], Mapping[str, str], Path], Process]
"""A function that starts a command with all environment variables and a file for its output."""


def start_command(command: Sequence[str], environment: Mapping[str, str], log: Path) -> Process:
    """Start a command in its own process group; the command is sent SIGTERM when this process ends."""
    with log.open("wb") as output:
        return subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=end_with_parent,
        )


class Job:
    """A command that `start` runs as a process in its own process group.

    Args:
        label: name of the job in messages.
        command: program and arguments.
        log: file of its output, replaced if it exists. The status file is beside it.
    """

    def __init__(self, label: str, command: Sequence[str], log: Path):
        self.label = label
        self.command = list(command)
        self.log = log
        self.status_file = log.with_suffix(".status.json")
        self.process: Process | None = None
        self.started_s = self.elapsed_s = 0.0

    def start(self, environment: Mapping[str, str], starter: Starter = start_command) -> None:
        """Start the process with these environment variables in addition to the variables of this process."""
        self.status_file.unlink(missing_ok=True)
        variables = {**os.environ, **environment, STATUS_FILE: str(self.status_file)}
        self.process = starter(self.command, variables, self.log)
        self.started_s = time.monotonic()

    @property
    def code(self) -> int | None:
        """Return the exit code; None before the end."""
        if self.process is None:
            return None
        code = self.process.poll()
        if code is not None and not self.elapsed_s:
            self.elapsed_s = self.age_s
        return code

    @property
    def age_s(self) -> float:
        """Return the time since its start, s, even after its end."""
        return time.monotonic() - self.started_s

    @property
    def running(self) -> bool:
        """Return whether it was started and has not ended."""
        return self.process is not None and self.code is None

    @property
    def waiting(self) -> bool:
        """Return whether it waits for the result of another job."""
        status = self.status
        return self.running and status is not None and status.state == "waiting"

    @property
    def status(self) -> Status | None:
        """Return its last reported status, None before the first."""
        return read_status(self.status_file)

    def last_lines(self, count: int = FAILURE_LINES) -> list[str]:
        """Return the last lines of its log that are not empty."""
        return last_lines(self.log, count)

    @property
    def group(self) -> int | None:
        """Return the id of its process group; None before it begins and after its end."""
        return self.process.pid if self.process is not None and self.running else None

    def send_signal(self, number: int) -> None:
        """Send a signal to its process group."""
        group = self.group
        if group is not None:
            with contextlib.suppress(ProcessLookupError):  # the process has just ended
                os.killpg(group, number)


def last_lines(log: Path, count: int = FAILURE_LINES) -> list[str]:
    """Return the last lines of a log that are not empty, from its last 4 KiB; none if there is no such file."""
    if not log.exists():
        return []
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - TAIL_BYTES))
        text = file.read().decode(errors="replace")
    return [line.rstrip() for line in text.splitlines() if line.strip()][-count:]


def label_of(overrides: Sequence[str]) -> str:
    """Return the name of a job with these overrides: `mono seed=1` for `+ablation=mono seed=1`."""
    return " ".join(override.removeprefix("+ablation=") for override in overrides)


def file_name(label: str, number: int) -> str:
    """Return the name of a job's log file."""
    return f"{number:03d}-{re.sub(r'[^A-Za-z0-9_.=-]+', '_', label)[:80]}.log"
