"""Serve the page that follows runs, to browsers on this machine alone.

Addresses: `/` and its files, `/api/runs`, `/api/run?id=...`, `/image?id=...&name=...`. Ids and names are looked up
among those that exist, never used as paths.
"""

import errno
import json
import sys
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from omniocc.errors import UserError
from omniocc.extras.viewer.watch.state import IMAGES, details, jobs, last_images, run_folders, run_states

HOST = "127.0.0.1"
OWN_NAMES = ("127.0.0.1", "localhost")
"""Names under which browsers of this machine reach the server; others are those of foreign pages (DNS rebinding)."""
PAGE = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Server(ThreadingHTTPServer):
    """A server of one folder of runs.

    Args:
        runs: the folder.
        port: at 127.0.0.1; 0 takes any free one.

    Raises:
        UserError: when there is no such folder, or the port is taken or reserved.
    """

    daemon_threads = True

    def __init__(self, runs: Path, port: int):
        if not runs.is_dir():
            raise UserError(
                f"watch={runs}: there is no such folder; the first training makes runs (python src/train.py), "
                "or give the folder that holds your runs"
            )
        self.runs = runs
        try:
            super().__init__((HOST, port), Handler)
        except OSError as error:
            reasons = {errno.EADDRINUSE: "taken by another program", errno.EACCES: "reserved for the system"}
            if error.errno not in reasons:
                raise
            remedy = f"choose another one: port={port + 1}, or port=0 for any"
            raise UserError(f"port={port} is {reasons[error.errno]}; {remedy}") from error

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of browsers that do not wait for an answer; report other errors."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)

    @property
    def url(self) -> str:
        """Return the address of the page."""
        return f"http://{HOST}:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "omniocc", ""

    def do_GET(self) -> None:
        """Answer with a file of the page, data or an image; with an error otherwise."""
        if not is_own(self.headers.get("Host", "")):
            return self._refuse(HTTPStatus.FORBIDDEN, "this page is for browsers on this machine")
        address = urlsplit(self.path)
        query = {key: values[0] for key, values in parse_qs(address.query).items()}
        try:
            found = answer(self.server.runs, address.path, query)
        except OSError:
            return self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "the run is being changed, ask again")
        except ValueError:
            return self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, "the run's files are damaged")
        if found is None:
            return self._refuse(HTTPStatus.NOT_FOUND, "there is nothing here")
        return self._send(HTTPStatus.OK, *found)

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self._send(status, text.encode(), "text/plain; charset=utf-8")

    def _send(self, status: HTTPStatus, content: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing: a page asks every few seconds."""


def is_own(host: str) -> bool:
    """Return whether a `Host` header names this machine, at any port, since a tunnel may have another one."""
    name, _, port = host.partition(":")
    return name in OWN_NAMES and (port.isdigit() or ":" not in host)


def answer(runs: Path, path: str, query: dict[str, str]) -> tuple[bytes, str] | None:
    """Return the content and type of what stands at an address; None if nothing does.

    Raises:
        OSError, ValueError: when files of a run change meanwhile, or are damaged.
    """
    if path in PAGE:
        name, kind = PAGE[path]
        return files("omniocc.extras.viewer.watch").joinpath("static").joinpath(name).read_bytes(), kind
    if path == "/api/runs":
        return as_json({"runs": [state.plain() for state in run_states(runs)], "jobs": jobs(runs)})
    folder = run_folders(runs).get(query.get("id", ""))
    if folder is None:
        return None
    if path == "/api/run":
        return as_json(details(folder))
    if path == "/image" and query.get("name") in last_images(folder):
        return (folder / IMAGES / query["name"]).read_bytes(), "image/png"
    return None


def as_json(content: object) -> tuple[bytes, str]:
    """Return plain data as JSON, and its type."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode(), "application/json"


def watch(runs: Path, port: int) -> None:
    """Serve the page until Ctrl-C.

    Raises:
        UserError: as `Server`.
    """
    with Server(runs, port) as server, suppress(KeyboardInterrupt):
        own, tunnel = server.url, f"ssh -L {server.server_port}:{HOST}:{server.server_port} <this machine>"
        print(f"from another machine: {tunnel}\n{own} follows {runs}, until Ctrl-C", flush=True)
        server.serve_forever()
