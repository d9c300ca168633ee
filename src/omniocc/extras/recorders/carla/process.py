"""The capturing process, watched: its messages, its time-outs, and what its failures mean."""

import contextlib
import json
import struct
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Full, Queue
from typing import Any, BinaryIO

from omniocc.errors import UserError, installing

CLIENT = Path(__file__).with_name("client.py")
GRACE_S = 10.0
"""Time to leave for a process that is told to, s."""
WAITING = 2
"""Messages that are read ahead; a frame has some hundred megabytes."""


class CarlaError(UserError):
    """A recording that cannot go on; `lasting` if trying again would not help."""

    def __init__(self, message: str, lasting: bool):
        super().__init__(message)
        self.lasting = lasting


@dataclass(frozen=True)
class Message:
    """One message of the capturing process: its header and its blobs by name."""

    header: dict[str, Any]
    blobs: dict[str, bytes]

    @property
    def kind(self) -> str:
        """Return what the message is: server, alive, frame, done or failed."""
        return self.header["kind"]


def read_message(file: BinaryIO) -> Message | None:
    """Return the next message; None at the end of the file, also in the middle of a message."""
    length = file.read(8)
    if len(length) < 8:
        return None
    line = file.read(size := struct.unpack("<Q", length)[0])
    if len(line) < size:
        return None
    header = json.loads(line)
    blobs = {name: file.read(count) for name, count in header["blobs"]}
    if any(len(blobs[name]) < count for name, count in header["blobs"]):
        return None
    return Message(header, blobs)


@contextmanager
def captured(
    python: Sequence[str], job: dict[str, Any], first_s: float, silence_s: float
) -> Iterator[Iterator[Message]]:
    """Start the capturing process for a job; give its messages; end it when the context ends.

    Args:
        python: command of a Python that has the module `carla`.
        job: as `client.py` reads it.
        first_s: longest time to the first tick of the loaded town, s.
        silence_s: time without a message after that, after which the server counts as hung, s.

    Raises:
        CarlaError: while messages are read, if the process fails, dies or is silent; when there is no such Python.
    """
    command = [*python, str(CLIENT)]
    try:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    except OSError as error:
        raise CarlaError(f"recorder.python={' '.join(python)} cannot be started: {error.strerror}", True) from error
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    messages: Queue[Message | None] = Queue(WAITING)
    tail: list[str] = []
    leaving = threading.Event()
    readers = [
        threading.Thread(target=_forward, args=(process.stdout, messages, leaving), daemon=True),
        threading.Thread(target=_keep_tail, args=(process.stderr, tail), daemon=True),
    ]
    for reader in readers:
        reader.start()
    try:
        try:
            process.stdin.write(json.dumps(job).encode() + b"\n")
            process.stdin.close()
        except BrokenPipeError as error:
            raise CarlaError(f"the capturing process ended at once: {_last(tail)}", True) from error
        yield _watched(messages, tail, job, first_s, silence_s)
    finally:
        leaving.set()
        _stop(process)
        for reader in readers:
            reader.join(GRACE_S)


def explain(reason: str, message: str, job: dict[str, Any]) -> CarlaError:
    """Return the error for a failure of the capturing process, with the remedy."""
    place = f"{job['host']}:{job['port']}"
    remedies = {
        "import": (
            f"this Python has no CARLA client ({message}): {installing('carla')} for a server 0.9.16 and Python "
            "3.11 or 3.12, or set recorder.python to a Python that has the client of your server (its wheel is in the "
            "server's PythonAPI/carla/dist)"
        ),
        "nobody": (
            f"no CARLA server answers at {place} ({message}): start one (./CarlaUE4.sh -RenderOffScreen), or give "
            "recorder.host and recorder.port"
        ),
        "version": (
            f"{place}: {message}; both must be of one version: set recorder.python to a Python with the server's client"
        ),
        "maps": f"recorder.maps: {message}",
        "weather": f"recorder.weather: {message}",
        "busy": f"{place}: {message}; use another server, or wait",
        "scene": message,
    }
    return CarlaError(remedies.get(reason, f"{place}: {message}"), reason in remedies)


def _watched(
    messages: "Queue[Message | None]", tail: list[str], job: dict[str, Any], first_s: float, silence_s: float
) -> Iterator[Message]:
    limit_s = first_s
    while True:
        try:
            message = messages.get(timeout=limit_s)
        except Empty as error:
            raise CarlaError(f"the CARLA server has not answered for {limit_s:g} s", False) from error
        if message is None:
            raise CarlaError(f"the capturing process was killed or crashed: {_last(tail)}", False)
        if message.kind == "failed":
            raise explain(message.header["reason"], message.header["message"], job)
        if message.kind == "done":
            return
        limit_s = first_s if message.kind == "server" else silence_s
        yield message


def _forward(file: BinaryIO, messages: "Queue[Message | None]", leaving: threading.Event) -> None:
    while not leaving.is_set():
        message = read_message(file)
        while not leaving.is_set():
            try:
                messages.put(message, timeout=0.2)
                break
            except Full:  # the recorder is slower than the server
                continue
        if message is None:
            return


def _keep_tail(file: BinaryIO, tail: list[str]) -> None:
    for line in file:
        tail.append(line.decode(errors="replace").strip())
        del tail[:-5]


def _last(tail: list[str]) -> str:
    return next((line for line in reversed(tail) if line), "it left no message")


def _stop(process: subprocess.Popen) -> None:
    """End a process that may wait for a server for ever."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    for file in (process.stdin, process.stdout, process.stderr):
        if file is not None:
            with contextlib.suppress(BrokenPipeError):  # the request that the process has not read
                file.close()
