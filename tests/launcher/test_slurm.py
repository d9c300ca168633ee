"""What runs inside of a Slurm job, and what is read of one, without Slurm; with Slurm: `tests/cluster`."""

import os
import signal
import sys
import threading
import time

import pytest
from submitit.core.utils import UncompletedJobError

from hydra_plugins.process_launcher.slurm import LIMIT, LOST, STOP, SlurmJob, Submitted, code_file, log_of, refusal

SAVES = """
import signal, sys, time
def stop(*_): print("saved", flush=True); sys.exit(1)
signal.signal(signal.SIGUSR2, stop)
print("ready", flush=True)
time.sleep(60)
"""
DEAF = "import time; print('ready', flush=True); time.sleep(60)"  # as before training begins


@pytest.fixture
def asked():
    """Return a list of what submitit's handler was asked, which is in place as in a job."""
    calls = []

    def handler(number, frame):
        calls.append(number)
        sys.exit(255)

    earlier = signal.signal(STOP, handler)
    yield calls
    signal.signal(STOP, earlier)


def run(log, code, warning_s=120.0):
    with pytest.raises(SystemExit) as ended:
        SlurmJob([sys.executable, "-c", code], log, {}, warning_s)()
    return ended.value.code


def signal_when_ready(log):
    def wait():
        while not log.exists() or "ready" not in log.read_text():
            time.sleep(0.05)
        os.kill(os.getpid(), STOP)

    threading.Thread(target=wait, daemon=True).start()


def test_the_code_of_the_command_is_kept_and_returned(tmp_path, asked):
    log = tmp_path / "000.log"
    assert run(log, "raise SystemExit('no such grid')") == 1
    assert (code_file(log, 0).read_text(), log.read_text()) == ("1\n", "no such grid\n")
    assert run(log, "print(1)") == 0
    assert code_file(log, 0).read_text() == "0\n"
    assert asked == []


def test_a_command_that_is_told_to_stop_saves_and_is_queued_again(tmp_path, asked):
    log = tmp_path / "000.log"
    signal_when_ready(log)
    assert run(log, SAVES) == 255
    assert asked == [STOP]
    assert log.read_text().splitlines() == ["ready", "saved"]
    assert not code_file(log, 0).exists()


def test_a_command_that_does_not_listen_is_ended_before_the_limit(tmp_path, asked):
    log = tmp_path / "000.log"
    signal_when_ready(log)
    assert run(log, DEAF, warning_s=1.0) == 255
    assert asked == [STOP]


def test_a_job_that_may_not_be_queued_again_says_so(tmp_path, monkeypatch):
    def refuse(number, frame):
        raise UncompletedJobError("Job not requeued because: timed-out too many times.")

    log, earlier = tmp_path / "000.log", signal.signal(STOP, refuse)
    signal_when_ready(log)
    assert run(log, SAVES) == LIMIT
    signal.signal(STOP, earlier)
    assert code_file(log, 0).read_text() == f"{LIMIT}\n"
    assert log.read_text().splitlines()[-1].startswith("the time limit of the Slurm job is reached: Job not requeued")


class Answer:
    def __init__(self, state):
        self.given = state

    def state(self, number):
        return self.given


def test_a_job_ends_when_all_its_tasks_have_or_when_slurm_has_lost_it(tmp_path, monkeypatch):
    monkeypatch.setattr("hydra_plugins.process_launcher.slurm.GONE_S", 0.0)
    log = tmp_path / "000.log"
    job = Submitted(Answer("RUNNING"), "1_0", log, 2)
    code_file(log, 0).write_text("0\n")
    assert job.poll() is None
    code_file(log, 1).write_text("3\n")
    assert job.poll() == 3
    assert log_of(log, 1).name == "000.task1.log"
    lost = Submitted(Answer("OUT_OF_MEMORY"), "1_1", tmp_path / "001.log", 1)
    for _ in range(2):  # the line is written once
        assert (lost.poll(), (tmp_path / "001.log").read_text()) == (LOST, "Slurm ended job 1_1: OUT_OF_MEMORY\n")


def test_of_a_refusal_the_reason_is_kept():
    text = "sbatch: warning: x\nsbatch: error: Batch job submission failed: Invalid partition name specified\n"
    assert refusal(text) == "Batch job submission failed: Invalid partition name specified"
    assert refusal("") == "it gives no reason"
