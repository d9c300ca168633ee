"""Scripts that start as copies of a process whose imports are done."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from omniocc.runs.fork_server import Copy, ForkServer

SCRIPT = """
import os, sys, time
from pathlib import Path

HERE = Path(__file__).parent
(HERE / f"imported-{os.getpid()}").touch()

def work():
    (HERE / f"worked-{os.getpid()}").touch()

if __name__ == "__main__":
    print(sys.argv[1:], os.environ.get("NAME"), os.environ.get("OMP_NUM_THREADS"), sys.path[0] == str(HERE), flush=True)
    print("beside", file=sys.stderr, flush=True)
    if sys.argv[1] == "sleep":
        time.sleep(60)
    sys.exit(int(sys.argv[1]))
"""


@pytest.fixture
def server(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    server = ForkServer(script, tmp_path / "imports.log")
    yield server
    server.close()


def start(server: ForkServer, folder: Path, argument: str, **environment: str) -> Copy:
    return server.start([argument, "b c"], {**os.environ, **environment}, folder / f"{argument}.log")


def wait_for(found, within_s: float = 20.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not found() and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert found()


def test_copies_have_their_own_arguments_environment_output_and_exit_code(server, tmp_path):
    first = start(server, tmp_path, "0", NAME="one", OMP_NUM_THREADS="3")
    second = start(server, tmp_path, "7", NAME="two")
    wait_for(lambda: first.poll() is not None and second.poll() is not None)
    assert (first.poll(), second.poll()) == (0, 7)
    assert (tmp_path / "0.log").read_text() == "['0', 'b c'] one 3 True\nbeside\n"
    assert (tmp_path / "7.log").read_text().startswith("['7', 'b c'] two")
    assert first.pid != second.pid


def test_imports_of_the_script_are_done_once_before_it_is_copied(server, tmp_path):
    copies = [start(server, tmp_path, "0") for _ in range(3)]
    wait_for(lambda: all(copy.poll() == 0 for copy in copies))
    once = {path.name for path in tmp_path.glob("imported-*")} - {f"imported-{copy.pid}" for copy in copies}
    assert len(once) == 1  # copies run the script itself again, as every start does, with its modules loaded
    assert {path.name.replace("worked", "imported") for path in tmp_path.glob("worked-*")} == once


def test_a_copy_is_the_head_of_a_group_that_can_be_ended(server, tmp_path):
    copy = start(server, tmp_path, "sleep")
    wait_for(lambda: copy.pid is not None and (tmp_path / "sleep.log").exists())
    wait_for(lambda: os.getpgid(copy.pid) == copy.pid)
    os.killpg(copy.pid, signal.SIGKILL)
    wait_for(lambda: copy.poll() == -signal.SIGKILL)


def test_copies_end_with_their_server_and_count_as_failed(server, tmp_path):
    copy = start(server, tmp_path, "sleep")
    wait_for(lambda: copy.pid is not None and (tmp_path / "sleep.log").exists() and "beside" in output(tmp_path))
    server.close()
    assert copy.poll() == -signal.SIGTERM

    def gone() -> bool:
        stat = Path(f"/proc/{copy.pid}/stat")
        return not stat.exists() or stat.read_text(encoding="utf-8").split()[2] == "Z"

    wait_for(gone)


def output(folder: Path) -> str:
    return (folder / "sleep.log").read_text()


def test_a_script_that_cannot_be_imported_fails_with_its_message(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("raise ImportError('not here')")
    server = ForkServer(script, tmp_path / "imports.log")
    copy = server.start([], {"PATH": os.environ["PATH"], "A": sys.executable}, tmp_path / "log")
    wait_for(lambda: copy.poll() is not None)
    assert copy.poll() == 1
    assert "not here" in (tmp_path / "imports.log").read_text()
