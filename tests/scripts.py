"""Run the scripts of `src/` in processes that are forked from one whose imports are done.

Imports take about nine seconds of processor time, a fork a few milliseconds. Everything else is as when the script is
started from a shell: arguments, working folder, environment, output and exit code. A process of tests has one server.
"""

import atexit
import functools
import json
import os
import runpy
import select
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
SCRIPTS = ["train.py", "evaluate.py", "predict.py", "export.py", "render.py", "report.py"]
PYTHONPATH = "PYTHONPATH"


def run_script(
    name: str, *arguments: str, cwd: Path | None = None, timeout_s: float = 400, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a script of `src/` to its end.

    Args:
        name: of the script.
        arguments: of its command line.
        cwd: folder in which it runs; None: the current one.
        timeout_s: after which it is killed, s.
        environment: further variables; folders in `PYTHONPATH` are searched for packages.

    Raises:
        subprocess.TimeoutExpired: when it takes longer.
    """
    command = [str(ROOT / "src" / name), *arguments]
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        request = {"argv": command, "cwd": str(cwd or Path.cwd()), "environment": {**os.environ, **environment}}
        code = _ask(request, [output.fileno(), errors.fileno()], timeout_s)
        texts = [file.read() for file in (output, errors) if file.seek(0) == 0]
    return subprocess.CompletedProcess(command, code, *texts)


def _ask(request: dict[str, Any], files: list[int], timeout_s: float) -> int:
    """Let the server run a script; return its exit code."""
    server = _server()
    request["files"] = [f"/proc/{os.getpid()}/fd/{number}" for number in files]
    server.stdin.write(json.dumps(request) + "\n")  # type: ignore[union-attr]
    server.stdin.flush()  # type: ignore[union-attr]
    if not select.select([server.stdout], [], [], timeout_s)[0]:
        _end(server)
        _server.cache_clear()
        raise subprocess.TimeoutExpired(request["argv"], timeout_s)
    return int(server.stdout.readline())  # type: ignore[union-attr]


@functools.cache
def _server() -> "subprocess.Popen[str]":
    """Start the process from which scripts are forked."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", PYTHONPATH: str(ROOT / "src")}
    command = [sys.executable, __file__]
    server = subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    atexit.register(_end, server)
    return server


def _end(server: "subprocess.Popen[str]") -> None:
    """Kill the server and the script that it runs."""
    if server.poll() is None:
        os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def _serve() -> dict[str, Any]:
    """Answer each request with an exit code; in the process that is forked for one, return the request."""
    for script in SCRIPTS:
        runpy.run_path(str(ROOT / "src" / script), run_name="imported")
    while line := sys.stdin.readline():
        process = os.fork()
        if process == 0:
            return json.loads(line)
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
    sys.exit()


def _become(request: dict[str, Any]) -> None:
    """Take over the arguments, folder, environment and files of a request."""
    output, errors = (os.open(path, os.O_WRONLY | os.O_APPEND) for path in request["files"])
    for number, file in enumerate((os.open(os.devnull, os.O_RDONLY), output, errors)):
        os.dup2(file, number)
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = request["argv"]
    sys.path[:0] = [folder for folder in os.environ.get(PYTHONPATH, "").split(os.pathsep) if folder]


if __name__ == "__main__":
    _become(request := _serve())
    runpy.run_path(request["argv"][0], run_name="__main__")
