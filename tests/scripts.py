"""Run the scripts of `src/` as copies of one process whose imports are done (`omniocc.runs.fork_server`).

Imports take about nine seconds of processor time, a copy a few milliseconds. Everything else is as when the script is
started from a shell: arguments, working folder, environment, output and exit code. A process of tests has one server,
which runs this file: it imports all that they import, and a copy becomes one of them.
"""

import ast
import atexit
import contextlib
import functools
import importlib
import json
import os
import resource
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

SRC = Path(__file__).parents[1] / "src"
COMMANDS = SRC / "omniocc" / "commands"
LOOK_EVERY_S = 0.02


def run_script(
    name: str,
    *arguments: str,
    cwd: Path | None = None,
    timeout_s: float = 400,
    kill_when: Callable[[], bool] = lambda: False,
    memory_bytes: int | None = None,
    **environment: str,
) -> subprocess.CompletedProcess[str]:
    """Run a script of `src/` to its end.

    Args:
        name: of the script.
        arguments: of its command line.
        cwd: folder in which it runs; None: the current one.
        timeout_s: after which it is killed, s.
        kill_when: is called again and again until it returns true; then the script and its processes get a SIGKILL.
        memory_bytes: that it and each of its processes may map beyond what the imports took; None: no limit.
        environment: further variables; folders in `PYTHONPATH` are searched for packages.

    Raises:
        subprocess.TimeoutExpired: when it takes longer.
    """
    command = [str(SRC / name), *arguments]
    with tempfile.TemporaryDirectory() as folder:
        output, errors = Path(folder) / "output", Path(folder) / "errors"
        place = {"cwd": str(cwd or Path.cwd()), "errors": str(errors), "memory_bytes": memory_bytes}
        server, log = _server()
        copy = server.start([json.dumps(place), *command], {**os.environ, **environment}, output)
        deadline = time.monotonic() + timeout_s
        try:
            while copy.poll() is None and not kill_when():
                if time.monotonic() > deadline:
                    raise subprocess.TimeoutExpired(command, timeout_s)
                time.sleep(LOOK_EVERY_S)
        finally:
            while copy.poll() is None:
                if copy.pid is not None:
                    with contextlib.suppress(ProcessLookupError):  # it has just ended
                        os.killpg(copy.pid, signal.SIGKILL)
                time.sleep(LOOK_EVERY_S)
        texts = [path.read_text() if path.exists() else log.read_text() for path in (output, errors)]
    return subprocess.CompletedProcess(command, copy.poll() or 0, *texts)


@functools.cache
def _server() -> tuple[Any, Path]:
    """Return the process from which scripts are copied, and the file of what its imports print."""
    from omniocc.runs.fork_server import ForkServer  # not in the server, which imports as a script does

    log = Path(tempfile.mkstemp(prefix="imports-", suffix=".log")[1])
    return ForkServer(Path(__file__), log), log


def become(place: dict[str, Any], command: list[str]) -> None:
    """Take over the folder, the error output and the limit of a request."""
    os.dup2(os.open(place["errors"], os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
    from wandb.sdk.data_types._private import MEDIA_TMP

    Path(MEDIA_TMP.name).mkdir(exist_ok=True)  # the script before has removed it at its end
    os.chdir(place["cwd"])
    tempfile.tempdir = None  # of this environment, not of the server's
    if place["memory_bytes"] is not None:
        mapped = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + place["memory_bytes"],) * 2)
    sys.argv = command
    sys.path[:0] = [folder for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep) if folder]


def run(path: str) -> int:
    """Run a script and return its exit code, after all that Python does at its end but for taking modules apart.

    That takes 0.3 s, longer than most scripts of tests.
    """
    code: Any = 0
    try:
        runpy.run_path(path, run_name="__main__")
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
        code = 1
    if isinstance(code, str):
        print(code, file=sys.stderr)
        code = 1
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return int(code or 0)


if __name__ == "imported":
    sys.path[0] = str(SRC)  # as if one of the scripts had been started
    import wandb.sdk.launch.inputs.internal  # noqa: F401  imported by every run with curves when it begins

    for path in sorted(COMMANDS.glob("[a-z]*.py")):  # also what their functions import
        imported = (node.module for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom))
        for module in filter(None, imported):
            importlib.import_module(module)
        importlib.import_module(f"omniocc.commands.{path.stem}")

if __name__ == "__main__":
    become(json.loads(sys.argv[1]), sys.argv[2:])
    os._exit(run(sys.argv[0]))
