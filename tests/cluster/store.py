"""An S3 server in an environment of its own, and a proxy before it that cuts its connections."""

import contextlib
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from slurm import free_port

MOTO = "moto[server,s3]==5.2.5"
KEYS = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1"}


def can_start() -> bool:
    """Return whether the server is installed or can be."""
    command = [sys.executable, "-m", "uv", "tool", "run", "--from", MOTO, "moto_server", "--help"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@contextlib.contextmanager
def s3_server(folder: Path) -> Iterator[int]:
    """Start an S3 server that keeps everything in memory, and give its port; end it with the context."""
    port = free_port()
    command = [sys.executable, "-m", "uv", "tool", "run", "--from", MOTO, "moto_server", "-H", "127.0.0.1", f"-p{port}"]
    with (folder / "moto.log").open("wb") as log:
        server = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
    try:
        wait_for(f"http://127.0.0.1:{port}/", server)
        yield port
    finally:
        server.terminate()
        server.wait(20)


def wait_for(url: str, server: subprocess.Popen, within_s: float = 60.0) -> None:
    """Wait until a server answers; raise RuntimeError if it ends or does not answer in time."""
    deadline_s = time.monotonic() + within_s
    while time.monotonic() < deadline_s and server.poll() is None:
        try:
            urllib.request.urlopen(url, timeout=5).close()
            return
        except urllib.error.HTTPError:
            return
        except OSError:
            time.sleep(0.2)
    raise RuntimeError(f"the S3 server does not start (exit code {server.poll()})")


class Proxy:
    """A TCP proxy that counts the bytes of a server's answers, and cuts all connections once, for some seconds.

    Args:
        target: port of the server.
        cut_after: bytes of answers after which it is cut; None: never.
        cut_s: how long no connection is taken then.
    """

    def __init__(self, target: int, cut_after: int | None = None, cut_s: float = 0.0):
        self.target, self.cut_after, self.cut_s = target, cut_after, cut_s
        self.port, self.passed, self.cuts = free_port(), 0, 0
        self._lock, self._open = threading.Lock(), set[socket.socket]()
        self._listener = self._listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def _listen(self) -> socket.socket:
        return socket.create_server(("127.0.0.1", self.port), backlog=64)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:  # closed by the cut
                time.sleep(self.cut_s)
                self._listener = self._listen()
                continue
            server = socket.create_connection(("127.0.0.1", self.target))
            with self._lock:
                self._open |= {client, server}
            threading.Thread(target=self._pump, args=(client, server, False), daemon=True).start()
            threading.Thread(target=self._pump, args=(server, client, True), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, counted: bool) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if counted and self._cut(len(data)):
                    return
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _cut(self, count: int) -> bool:
        with self._lock:
            self.passed += count
            if self.cuts or self.cut_after is None or self.passed < self.cut_after:
                return False
            self.cuts = 1
            for end in self._open:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
            self._listener.shutdown(socket.SHUT_RDWR)
            self._listener.close()
            return True
