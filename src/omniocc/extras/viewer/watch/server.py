"""Serve the page that follows runs, to browsers on this machine alone: how far they are, their curves and last images.

Addresses: `/` and its files, `/api/runs`, `/api/run?id=...`, `/image?id=...&name=...`. Ids and names are looked up
among those that exist, never used as paths.
"""

import errno
import json
import sys
import time
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

from omniocc.bounds import fits
from omniocc.errors import UserError
from omniocc.extras.viewer.watch.files import (
    Identity,
    config_of,
    curves_of,
    held_locks,
    identity,
    modified_s,
    problem_of_results,
)
from omniocc.progress import clock, read_status
from omniocc.runs.curves import Curve, curve_files, read_rows
from omniocc.runs.results import IMAGES, METRICS

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
LOCK = ".lock"
STAGES = "stages"
"""Folder of the earlier stages in the folder of runs, and prefix of their ids."""
SCORES = {
    "depth": ("val/depth/mae",),
    "sketch": ("val/sketch/recall",),
    "occupancy": ("val/rayiou", "val/lidar/rayiou"),
}
"""Stages, and the main scores of each: the first that was logged is shown."""
RECENT_S = 120.0
"""A run whose files have changed within this time is taken to be in progress where no lock can be seen."""
LAST_IMAGES, MOST_POINTS = 6, 1000
State = Literal["in progress", "finished", "stopped", "unreadable"]


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
    """Answers the requests of one connection."""

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


@dataclass(frozen=True)
class RunState:
    """What a run is doing.

    Attributes:
        id: path of its folder relative to the folder of runs.
        stage: `depth`, `sketch` or `occupancy`.
        state: whether it goes on, has finished or was stopped; `unreadable` where its curves are damaged or gone.
        step: optimiser steps so far.
        steps: in all; None where the configuration limits epochs alone.
        left: time left at the rate since the last start, in words; empty where unknown.
        changed_s: seconds since its files have changed.
        score: key and last value of its main score of validation; None before the first.
        problem: what is wrong with its files, `left out: <file> ...`; empty where nothing is.
    """

    id: str
    stage: str
    state: State
    step: int = 0
    steps: int | None = None
    left: str = ""
    changed_s: float = 0.0
    score: tuple[str, float] | None = None
    problem: str = ""

    def plain(self) -> dict[str, Any]:
        """Return it as plain data, with the time since the last change in words."""
        return {**asdict(self), "changed": clock(self.changed_s)}


def run_folders(runs: Path) -> dict[str, Path]:
    """Return by id the folders below `runs` and `runs/stages` that hold the CSV files of a training."""
    parents = [("", runs), (f"{STAGES}/", runs / STAGES)]
    return {
        f"{prefix}{path.name}": path
        for prefix, parent in parents
        if parent.is_dir()
        for path in sorted(parent.iterdir())
        # a page cannot ask for a name that is no Unicode; names of runs are printable
        if not path.name.startswith(".") and path.name.isprintable() and curve_files(path)
    }


def run_states(runs: Path) -> list[RunState]:
    """Return what all runs are doing, those that changed last first."""
    now_s, held = time.time(), held_locks()
    states = [run_state(name, folder, now_s, held) for name, folder in run_folders(runs).items()]
    return sorted(states, key=lambda state: state.changed_s)


def run_state(name: str, folder: Path, now_s: float, held: Collection[Identity]) -> RunState:
    """Return what one run is doing at a time, s since 1970, given the files that are locked."""
    stage, changed_s = stage_of(name), max(0.0, now_s - changed_at_s(folder))
    try:
        (curves, damage), (config, other_damage) = curves_of(folder), config_of(folder)
        problem = damage or other_damage or problem_of_results(folder)
    except OSError as error:  # removed meanwhile
        damage = problem = f"left out: {error}"
    if damage:
        return RunState(name, stage, "unreadable", changed_s=changed_s, problem=problem)
    last, steps = max((max(curve) for curve in curves.values()), default=-1), configured_steps(config, stage)
    key = next((key for key in SCORES[stage] if key in curves), None)
    state = state_of(folder, changed_s, held)
    return RunState(
        id=name,
        stage=stage,
        state=state,
        step=last + 1 if steps is None else min(last + 1, steps),
        steps=steps,
        left="" if state != "in progress" or steps is None else time_left(folder, steps, now_s),
        changed_s=changed_s,
        score=None if key is None else (key, curves[key][max(curves[key])]),
        problem=problem,
    )


def state_of(folder: Path, changed_s: float, held: Collection[Identity]) -> State:
    """Return whether a run goes on; a stage is finished when it has written figures, itself or for its candidates."""
    lock = identity(folder / LOCK)
    if lock is not None and lock in held:
        return "in progress"
    if any(path.is_file() for path in [folder / METRICS, *folder.glob(f"candidates-*/{METRICS}")]):
        return "finished"
    return "in progress" if changed_s < RECENT_S else "stopped"


def stage_of(name: str) -> str:
    """Return the stage of a run: `stages/depth-0a1b2c3d` is of `depth`."""
    parent, _, own = name.rpartition("/")
    kind = own.partition("-")[0]
    return kind if parent == STAGES and kind in SCORES else "occupancy"


def changed_at_s(folder: Path) -> float:
    """Return the time at which the files of a run last changed, s since 1970."""
    paths = [*curve_files(folder), *folder.glob("*.ckpt"), folder / METRICS, folder / IMAGES]
    return max(map(modified_s, paths))


def configured_steps(config: Mapping[str, Any], stage: str) -> int | None:
    """Return the optimiser steps that a run's configuration asks for; None if it limits epochs alone."""
    steps = (config.get("stages", {}).get(stage) or {}).get("max_steps")
    return steps if steps is not None and fits(steps, int) and steps > 0 else None


def time_left(folder: Path, steps: int, now_s: float) -> str:
    """Return the time left at the rate since the last start, in words; empty before its second line.

    The folder of a CSV file is as old as the file's first line.
    """
    path = curve_files(folder)[-1]
    done = [int(row["step"]) for row in read_rows(path)]
    elapsed_s = modified_s(path) - modified_s(path.parent)
    if not done or max(done) == min(done) or elapsed_s <= 0:
        return ""
    left_s = (steps - 1 - max(done)) * elapsed_s / (max(done) - min(done)) - (now_s - modified_s(path))
    return clock(max(0.0, left_s))


def details(folder: Path) -> dict[str, Any]:
    """Return the curves of a run as points (step, value) by key, none where they are damaged, and its last images."""
    curves = {key: thinned(curve) for key, curve in curves_of(folder)[0].items() if key != "epoch"}
    return {"curves": curves, "images": last_images(folder)}


def thinned(curve: Curve) -> list[tuple[int, float]]:
    """Return at most `MOST_POINTS` points of a curve, evenly spread, the last included."""
    points = sorted(curve.items())
    stride = max(1, -(-len(points) // MOST_POINTS))
    return points[::-1][::stride][::-1]


def last_images(folder: Path) -> list[str]:
    """Return the names of the images that a run has drawn last, the newest first."""
    own = folder.resolve() / IMAGES
    # a link could show any image of this machine
    paths = [path for path in own.glob("*.png") if path.is_file() and path.resolve().parent == own]
    return [path.name for path in sorted(paths, key=modified_s, reverse=True)[:LAST_IMAGES]]


def jobs(runs: Path) -> list[dict[str, str]]:
    """Return the jobs of multiruns that report their progress at this time: the name of each, and what it does."""
    now_s, found = time.time(), []
    for path in sorted((runs / "sweeps").glob("**/*.status.json")):
        if now_s - modified_s(path) < RECENT_S:
            try:
                status = str(read_status(path) or "begins")
            except (OSError, ValueError, TypeError) as error:  # damaged
                status = f"its status cannot be read: {error}"
            found.append({"job": path.name.removesuffix(".status.json"), "status": status})
    return found
