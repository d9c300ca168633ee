"""What runs in each Slurm job: the command of one job of a multirun, which may be told to stop and go on later."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from omniocc.io import atomic_write

STOP = signal.SIGUSR2
"""Signal that Slurm sends some time before the limit, and that training answers with a checkpoint (`StopAtSignal`)."""
MARGIN_S = 30.0
"""Time before the limit at which a command that has not ended by itself is ended, s."""
POLL_S = 0.5
LIMIT = 75
"""Exit code of a command that has reached the time limit too often."""


class SlurmJob:
    """Run a command in a Slurm job and leave its exit code in a file; before the time limit let it stop, and requeue.

    submitit pickles this object and calls it in every task of the job.

    Args:
        command: program and arguments.
        log: file of its output, continued if it exists; tasks after the first have one each beside it.
        environment: further variables.
        warning_s: time between Slurm's signal and the limit, s.
    """

    def __init__(self, command: Sequence[str], log: Path, environment: Mapping[str, str], warning_s: float):
        self.command, self.log, self.environment = list(command), log, dict(environment)
        self.patience_s = max(1.0, warning_s - MARGIN_S)
        self.signalled_s: float | None = None

    def __call__(self) -> None:
        """Run the command and end with its exit code; a command that the limit stopped is queued again."""
        task = int(os.environ.get("SLURM_PROCID", "0"))
        code_file(self.log, task).unlink(missing_ok=True)
        requeue = signal.signal(STOP, self._note)
        with log_of(self.log, task).open("ab") as output:
            child = subprocess.Popen(
                self.command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, **self.environment},
                preexec_fn=_ignore_stop,
            )
        code = self._wait(child)
        if self.signalled_s is not None and code != 0 and callable(requeue):
            code = self._queue_again(requeue, task)
        if code is not None:
            atomic_write(code_file(self.log, task), f"{code}\n")
        sys.exit(code or 0)  # so that Slurm knows too

    def checkpoint(self) -> Any:
        """Return what is run after the requeue: the same command."""
        from submitit.helpers import DelayedSubmission

        self.signalled_s = None
        return DelayedSubmission(self)

    def _queue_again(self, requeue: Callable[[int, None], Any], task: int) -> int | None:
        """Let submitit queue the job again, which ends the first task; return a code if it refuses."""
        signal.signal(STOP, signal.SIG_IGN)
        try:
            requeue(STOP, None)
        except RuntimeError as error:
            with log_of(self.log, task).open("a") as output:
                output.write(f"the time limit of the Slurm job is reached: {error} The same command goes on.\n")
            return LIMIT
        return None

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.signalled_s = time.monotonic()

    def _wait(self, child: subprocess.Popen) -> int:
        told = False
        while (code := child.poll()) is None:
            if self.signalled_s is not None:
                if not told:
                    child.send_signal(STOP)
                    told = True
                if time.monotonic() - self.signalled_s > self.patience_s:
                    child.kill()
            time.sleep(POLL_S)
        return code


def log_of(log: Path, task: int) -> Path:
    """Return the file of the output of one task of a job."""
    return log if task == 0 else log.with_suffix(f".task{task}{log.suffix}")


def code_file(log: Path, task: int) -> Path:
    """Return the file with the exit code of one task of a job."""
    return log_of(log, task).with_suffix(".code")


def _ignore_stop() -> None:
    """Ignore the signal in the child until it is ready for it: Slurm sends it to every process of a job."""
    with contextlib.suppress(ValueError):
        signal.signal(STOP, signal.SIG_IGN)
