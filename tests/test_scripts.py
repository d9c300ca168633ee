"""Each script gets its own exit code, whatever befell the one before; with a server that only answers."""

import subprocess
import sys

import pytest
import scripts

NO_GROUP = 2**22 + 1
"""Above the largest number of a process on Linux."""
SERVER = """
import json, sys, time
for line in sys.stdin:
    wait, code = json.loads(line)["argv"][1:]
    if float(wait) > 0:
        print({group}, flush=True)
        time.sleep(float(wait))
        print(code, flush=True)
    else:
        print({group}, code, sep=chr(10), flush=True)
"""


@pytest.fixture(autouse=True)
def server(monkeypatch):
    with scripts.start(sys.executable, "-c", SERVER.format(group=NO_GROUP)) as process:
        monkeypatch.setattr(scripts, "_server", lambda: process)
        yield
        process.stdin.close()


def code_of(wait_s, code, **options):
    return scripts.run_script("train.py", str(wait_s), str(code), **options).returncode


def test_a_script_that_ends_at_once_is_not_waited_for():
    assert [code_of(0, 3, timeout_s=5), code_of(0, 4, timeout_s=5)] == [3, 4]


def test_a_script_that_ended_in_the_moment_of_its_kill_keeps_its_code():
    assert [code_of(0.1, 3, kill_when=lambda: True), code_of(0, 4)] == [3, 4]


def test_the_script_after_one_that_took_too_long_gets_its_own_code():
    with pytest.raises(subprocess.TimeoutExpired):
        code_of(0.3, 3, timeout_s=0.1)
    assert code_of(0, 4) == 4


def test_the_script_after_an_error_of_the_test_gets_its_own_code():
    with pytest.raises(ZeroDivisionError):
        code_of(0.1, 3, kill_when=lambda: 1 / 0)
    assert code_of(0, 4) == 4
