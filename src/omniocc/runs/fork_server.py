"""Start a script many times as copies of one process whose imports are done.

Imports take some seven seconds of processor time, a copy some milliseconds. The process that is copied only imports: it
starts no thread, touches no GPU and computes nothing. It speaks lines of JSON: a request for each copy, and an answer
when the copy begins and when it ends. This module imports the standard library alone, as `omniocc.progress` does.
"""

import contextlib
import ctypes
import gc
import json
import os
import runpy
import select
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

PR_SET_PDEATHSIG = 1
THREADS = "OMP_NUM_THREADS"


def end_with_parent() -> None:
    """Ask Linux, in the child, to send it SIGTERM when its parent ends for any reason."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


class Copy:
    """A copy that runs the script; it has no process id before it has begun."""

    def __init__(self, server: "ForkServer", number: int):
        self._server, self._number = server, number

    @property
    def pid(self) -> int | None:
        """Return the process, which leads a group of its own; None before it begins."""
        return self._server.answers(self._number).get("pid")

    def poll(self) -> int | None:
        """Return the exit code, negative after a signal; None before the end."""
        return self._server.answers(self._number).get("code")


class ForkServer:
    """Starts copies of a process that has imported a script; all of them end with it, and it with this process.

    Args:
        script: file of Python whose imports are done once, also those of its function `work` if it has one; it must do
            nothing else then.
        log: file for what the imports print.
    """

    def __init__(self, script: Path, log: Path):
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(script)],
                env={**os.environ, THREADS: "1"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=output,
                start_new_session=True,
                preexec_fn=end_with_parent,
            )
        os.set_blocking(self._output, False)
        self._rest = b""
        self._answers: list[dict[str, int]] = []

    def start(self, arguments: Sequence[str], environment: Mapping[str, str], log: Path) -> Copy:
        """Run the script with these arguments; output goes to `log`, which is replaced."""
        request = {"arguments": [*arguments], "environment": {**environment}, "log": str(log.resolve())}
        self._answers.append({})
        with contextlib.suppress(BrokenPipeError):  # the server has ended, which `answers` tells
            self._process.stdin.write(json.dumps(request).encode() + b"\n")  # type: ignore[union-attr]
            self._process.stdin.flush()  # type: ignore[union-attr]
        return Copy(self, len(self._answers) - 1)

    def answers(self, number: int) -> dict[str, int]:
        """Return what is known of a copy; when this server has ended, its exit code is that of all that still ran."""
        ended = self._process.poll()
        self._read()
        answer = self._answers[number]
        if ended is not None:
            answer.setdefault("code", ended or 1)
        return answer

    def close(self) -> None:
        """End the server, and with it all copies."""
        self._process.terminate()
        self._process.wait()

    @property
    def _output(self) -> int:
        return self._process.stdout.fileno()  # type: ignore[union-attr]

    def _read(self) -> None:
        """Take in the answers that have come."""
        while select.select([self._output], [], [], 0)[0]:
            chunk = os.read(self._output, 1 << 16)
            if not chunk:
                break
            *lines, self._rest = (self._rest + chunk).split(b"\n")
            for line in map(json.loads, lines):
                self._answers[line.pop("number")].update(line)


def serve(script: str) -> dict[str, Any]:
    """Import a script and answer requests; in a copy, return its request."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what is printed must not look like an answer
    runpy.run_path(script, run_name="imported").get("work", str)()
    gc.collect()
    gc.freeze()  # garbage collection in a copy then leaves the memory alone that copies have in common
    requests = os.fdopen(os.dup(0), "rb", buffering=0)
    running: dict[int, tuple[int, int]] = {}
    count = 0
    while True:
        ready = select.select([requests, *running], [], [])[0]
        for ended in [process for process in running if process in ready]:
            number, pid = running.pop(ended)
            os.close(ended)
            code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            print(json.dumps({"number": number, "code": code}), file=answers, flush=True)
        if requests in ready:
            line = requests.readline()
            if not line:
                sys.exit()
            pid = os.fork()
            if pid == 0:
                return json.loads(line)
            os.setpgid(pid, pid)  # by both, so that the group exists when its number is known
            running[os.pidfd_open(pid)] = count, pid  # can be read from when the process has ended
            print(json.dumps({"number": count, "pid": pid}), file=answers, flush=True)
            count += 1


def become(script: str, request: Mapping[str, Any]) -> None:
    """Take over arguments, environment and output of a request, in a group of processes of its own."""
    os.setpgid(0, 0)
    end_with_parent()
    output = os.open(request["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    for number, file in enumerate((os.open(os.devnull, os.O_RDONLY), output, output)):
        os.dup2(file, number)
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = [script, *request["arguments"]]
    if THREADS in os.environ and "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(int(os.environ[THREADS]))


if __name__ == "__main__":
    sys.path[0] = str(Path(sys.argv[1]).parent)  # as if the script had been started
    become(sys.argv[1], serve(sys.argv[1]))
    runpy.run_path(sys.argv[0], run_name="__main__")
