"""Where a time line goes: a file, a viewer that is started here, or one that runs elsewhere."""

import contextlib
import os
import re
import shutil
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from typing import BinaryIO

import rerun as rr
import rerun_bindings

from omniocc.errors import UserError, first_line
from omniocc.io import atomic_file

APPLICATION = "omniocc"
PORT = 9876
"""The port at which Rerun's viewer listens."""
OWN_HOST = "127.0.0.1"
OWN_ARGUMENTS = ["--bind", OWN_HOST]
"""Of a viewer that is started here: it asks for no password, and listens on all interfaces unless it is told."""
ADDRESS = re.compile(r"(?:rerun\+)?(?:https?://)?(?P<host>\[[0-9a-fA-F:]+\]|[^:/\s]+)(?::(?P<port>\d+))?(?:/proxy)?/?")
CONNECT_S, FLUSH_S = 3.0, 60.0
CHUNK_BYTES = 2**20


class FileCopy(Thread):
    """Copies a pipe to a file until the pipe's other end is closed; an error of the file is kept, and the rest read.

    Rerun writes to the pipe: after an error of its own file (a full disk) it may wait for ever.
    """

    def __init__(self, source: int, target: BinaryIO):
        super().__init__(daemon=True)
        self.source, self.target = source, target
        self.error: OSError | None = None

    def run(self) -> None:
        """Copy."""
        with os.fdopen(self.source, "rb") as source:
            try:
                shutil.copyfileobj(source, self.target, CHUNK_BYTES)
                self.target.flush()
            except OSError as error:
                self.error = error
                while source.read(CHUNK_BYTES):
                    pass


@contextlib.contextmanager
def to_file(path: Path, name: str) -> Iterator[rr.RecordingStream]:
    """Give a recording whose content is in a file after the block: whole, or not at all.

    `name` is the recording's title.

    Raises:
        DataError: when the file cannot be written.
    """
    with atomic_file(path) as file:
        source, target = os.pipe()
        copy = FileCopy(source, file)
        recording = rr.RecordingStream(APPLICATION)
        recording.save(f"/dev/fd/{target}")
        os.close(target)  # Rerun has opened it again
        copy.start()
        try:
            recording.send_recording_name(name)
            yield recording
            recording.flush()
        finally:
            recording.disconnect()
            copy.join()
        if copy.error is not None:
            raise copy.error


@contextlib.contextmanager
def to_viewer(address: str, name: str) -> Iterator[rr.RecordingStream]:
    """Give a recording that a running viewer shows while it grows.

    Args:
        address: `host:port` (the port may be left out), or the URL that the viewer prints.
        name: the recording's title.

    Raises:
        UserError: when nothing listens there, or the connection breaks.
    """
    host, port = check_listening(address)
    recording = rr.RecordingStream(APPLICATION)
    recording.connect_grpc(f"rerun+http://{host}:{port}/proxy")
    with _flushed(recording, f"the viewer at {address}"):
        recording.send_recording_name(name)
        yield recording


def check_listening(address: str) -> tuple[str, int]:
    """Return host and port of a viewer; raise UserError when nothing listens there."""
    host, port = host_and_port(address)
    try:
        socket.create_connection((host.strip("[]"), port), CONNECT_S).close()
    except OSError as error:
        raise UserError(
            f"{address}: no viewer listens at {host}:{port} ({error.strerror or error}); start one with `rerun` there, "
            "or write a file: save=view.rrd"
        ) from error
    return host, port


def host_and_port(address: str) -> tuple[str, int]:
    """Return host and port of an address; raise UserError if it is none."""
    match = ADDRESS.fullmatch(address)
    port = int(match["port"] or PORT) if match else 0
    if match is None or not 0 < port < 65536:
        raise UserError(f"'{address}' is no address of a viewer; give host:port, such as 127.0.0.1:{PORT}")
    return match["host"], port


@contextlib.contextmanager
def to_own_viewer(name: str) -> Iterator[rr.RecordingStream]:
    """Give a recording that a viewer shows, which is started here, or is running here already.

    Raises:
        UserError: when there is no display to open a window on, or the viewer is closed before it has all frames.
    """
    check_display()
    recording = rr.RecordingStream(APPLICATION)
    try:
        # as rr.spawn, which has no argument for the address
        rerun_bindings.spawn(port=PORT, extra_args=OWN_ARGUMENTS, extra_env=[("RERUN_APP_ONLY", "true")])
        recording.connect_grpc(f"rerun+http://{OWN_HOST}:{PORT}/proxy")
    except Exception as error:  # Rerun raises its own types
        raise UserError(f"the viewer does not start: {first_line(error)}; write a file: save=view.rrd") from error
    with _flushed(recording, "the viewer"):
        recording.send_recording_name(name)
        yield recording


@contextlib.contextmanager
def _flushed(recording: rr.RecordingStream, viewer: str) -> Iterator[None]:
    """Send all frames to a viewer when the context ends, and disconnect in any case."""
    try:
        yield
        try:
            recording.flush(timeout_sec=FLUSH_S)
        except Exception as error:  # Rerun raises its own types
            raise UserError(f"{viewer} did not receive all frames: {first_line(error)}") from error
    finally:
        recording.disconnect()


def check_display() -> None:
    """Check that a window can be opened; raise UserError naming what else there is."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UserError(
            "there is no display to open a viewer on: write a page for any browser with page=true, or a file for Rerun "
            "with save=view.rrd, or show it in a viewer that runs elsewhere: connect=<host>:9876"
        )


def check_place(save: Path | None, connect: str | None) -> None:
    """Check that frames can be shown, before they are computed: at `connect`, or without both on this machine.

    Raises:
        UserError: as `to_viewer` and `to_own_viewer`.
    """
    if connect is not None:
        check_listening(connect)
    elif save is None:
        check_display()
