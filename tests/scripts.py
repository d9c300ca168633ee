"""Run the scripts of `src/` in processes that are forked from one whose imports are done.

Imports take about nine seconds of processor time, a fork a few milliseconds. Everything else is as when the script is
started from a shell: arguments, working folder, environment, output and exit code. A process of tests has one server.
"""

import atexit
import contextlib
import functools
import gc
import json
import os
import resource
import runpy
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
SCRIPTS = ["train.py", "evaluate.py", "predict.py", "check.py", "export.py", "mask.py", "record.py", "render.py"]
SCRIPTS += ["report.py", "view.py"]
PYTHONPATH = "PYTHONPATH"


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
    command = [str(ROOT / "src" / name), *arguments]
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        request = {"argv": command, "cwd": str(cwd or Path.cwd()), "environment": {**os.environ, **environment}}
        request["memory_bytes"] = memory_bytes
        code = _ask(request, [output.fileno(), errors.fileno()], timeout_s, kill_when)
        texts = [file.read() for file in (output, errors) if file.seek(0) == 0]
    return subprocess.CompletedProcess(command, code, *texts)


def _ask(request: dict[str, Any], files: list[int], timeout_s: float, kill_when: Callable[[], bool]) -> int:
    """Let the server run a script; return its exit code."""
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    request["files"] = [f"/proc/{os.getpid()}/fd/{number}" for number in files]
    server.stdin.write(json.dumps(request).encode() + b"\n")
    group = int(server.stdout.readline())
    deadline = time.monotonic() + timeout_s
    ended = False
    try:
        while not (ended := bool(select.select([server.stdout], [], [], 0.02)[0])) and not kill_when():
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(request["argv"], timeout_s)
    finally:
        if not ended:
            _kill(group)
        code = int(server.stdout.readline())  # in any case, else the next script would get it
    return code


def _kill(group: int) -> None:
    """Kill the processes of a group; do nothing if they have just ended."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


@functools.cache
def _server() -> "subprocess.Popen[bytes]":
    """Start the process from which scripts are forked; it ends with this one."""
    return start(sys.executable, __file__)


def start(*command: str) -> "subprocess.Popen[bytes]":
    """Start a process that is asked by lines, without buffers: `select` sees every line that was not read yet."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", PYTHONPATH: str(ROOT / "src")}
    return subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)


def _serve() -> dict[str, Any]:
    """Answer each request with a process group and an exit code; in the process that is forked, return the request."""
    import wandb.sdk.launch.inputs.internal  # noqa: F401  imported by every run with curves when it begins

    for script in SCRIPTS:
        runpy.run_path(str(ROOT / "src" / script), run_name="imported")
    gc.collect()
    gc.freeze()
    while line := sys.stdin.readline():
        process = os.fork()
        if process == 0:
            os.setpgid(0, 0)
            return json.loads(line)
        os.setpgid(process, process)  # by both, since either may be the first
        print(process, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
    sys.exit()


def _become(request: dict[str, Any]) -> None:
    """Take over the arguments, folder, environment and files of a request."""
    output, errors = (os.open(path, os.O_WRONLY | os.O_APPEND) for path in request["files"])
    for number, file in enumerate((os.open(os.devnull, os.O_RDONLY), output, errors)):
        os.dup2(file, number)
    from wandb.sdk.data_types._private import MEDIA_TMP

    Path(MEDIA_TMP.name).mkdir(exist_ok=True)  # the script before has removed it at its end
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["environment"])
    tempfile.tempdir = None  # of this environment, not of the server's
    if request["memory_bytes"] is not None:
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + request["memory_bytes"],) * 2)
    sys.argv = request["argv"]
    sys.path[:0] = [folder for folder in os.environ.get(PYTHONPATH, "").split(os.pathsep) if folder]


def _run(path: str) -> int:
    """Run a script and return its exit code, after all that Python does at its end but for taking modules apart."""
    code: Any = 0
    try:
        runpy.run_path(path, run_name="__main__")
    except SystemExit as end:
        code = end.code
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 1
    if isinstance(code, str):
        print(code, file=sys.stderr)
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return int(bool(code)) if isinstance(code, str) else int(code or 0)


if __name__ == "__main__":
    _become(request := _serve())
    os._exit(_run(request["argv"][0]))
