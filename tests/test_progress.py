"""One helper counts all long work, on the screen and in the status file."""

import subprocess
import sys

import pytest

from omniocc.progress import STATUS_FILE, Progress, Status, clock, read_status, show_waiting, write_status


def test_frames_that_were_there_do_not_count_as_fast(monkeypatch, capsys):
    now = [100.0]
    monkeypatch.setattr("omniocc.progress.time.monotonic", lambda: now[0])
    with Progress("rendering", 1000) as progress:
        progress.advance(900)  # finished by an interrupted run
        now[0] += 20.0
        for _ in range(10):
            progress.advance()
        assert progress.rate_hz == pytest.approx(0.5)
        now[0] += 20.0
    first, last = capsys.readouterr().err.splitlines()
    assert first == "rendering: 901/1000 frames"  # one frame alone, which may have compiled, tells no rate
    assert last == "rendering: 910/1000 frames, 4.00 s each, 6:00 min left"


def test_the_rate_forgets_a_slow_start_and_what_was_long_ago(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("omniocc.progress.time.monotonic", lambda: now[0])
    with Progress("training", 1000, "steps") as progress:
        for seconds in (60.0, *[2.0] * 10):  # the first step compiles
            now[0] += seconds
            progress.advance()
        assert progress.rate_hz == pytest.approx(0.5)
        for _ in range(20):  # another training begins on this machine
            now[0] += 8.0
            progress.advance()
        assert progress.rate_hz == pytest.approx(1 / 8)


def test_frames_of_another_process_count_for_the_time_that_is_left(monkeypatch, capsys):
    now, finished = [100.0], [0]
    monkeypatch.setattr("omniocc.progress.time.monotonic", lambda: now[0])
    with Progress("rendering", 100, finished=lambda: finished[0]) as progress:
        for own in range(1, 12):
            finished[0] = own // 5 * 10  # a scene of five frames here, and one there
            now[0] += 2.0
            progress.advance()
        finished[0] = 100
        progress.advance(100 - 11)  # found there
    assert capsys.readouterr().err.splitlines() == [
        "rendering: 10/100 frames, 1.56 s each, 2:20 min left",
        "rendering: 100/100 frames, 2.00 s each",
    ]


def test_clock():
    assert [clock(value) for value in (59.9, 3599.0, 3600.0, 86399.0, 129600.0)] == [
        *("0:59 min", "59:59 min", "1:00 h", "23:59 h", "1.5 days")
    ]


def test_counts_are_reported_in_the_status_file(tmp_path, monkeypatch):
    path, now = tmp_path / "status.json", [100.0]
    monkeypatch.setenv(STATUS_FILE, str(path))
    monkeypatch.setattr("omniocc.progress.time.monotonic", lambda: now[0])
    assert read_status(path) is None
    with Progress("depth train", 100, "steps", done=40) as progress:
        assert read_status(path) == Status("running", "depth train", 40, 100, "steps")
        for _ in range(10):
            now[0] += 2.0
            progress.advance(text="train/loss=1.5")
        reported = read_status(path)
        assert reported == Status(
            "running", "depth train", 50, 100, "steps", rate_hz=0.5, left_s=100.0, text="train/loss=1.5"
        )
        assert str(reported) == "depth train: 50/100 steps, 2.00 s each, 1:40 min left  train/loss=1.5"
    assert [file.name for file in tmp_path.iterdir()] == ["status.json"]


def test_waiting_ends_with_the_next_count(tmp_path, monkeypatch, capsys):
    path = tmp_path / "status.json"
    monkeypatch.setenv(STATUS_FILE, str(path))
    with Progress("rendering", 10) as progress:
        progress.wait("another process renders scene 3")
        assert read_status(path) == Status("waiting", "another process renders scene 3")
        progress.advance()
        assert read_status(path).state == "running"
    assert "another process renders scene 3" in capsys.readouterr().err


def test_a_block_of_waiting_is_reported(tmp_path, monkeypatch, capsys):
    path = tmp_path / "status.json"
    monkeypatch.setenv(STATUS_FILE, str(path))
    with show_waiting("depth", "waits for its folder"):
        assert read_status(path) == Status("waiting", "depth waits for its folder")
    assert read_status(path) == Status("running", "depth")
    assert capsys.readouterr().out == "depth waits for its folder\n"


def test_a_status_that_cannot_be_written_ends_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv(STATUS_FILE, str(tmp_path / "no such folder" / "status.json"))
    write_status(Status("running", "x"))
    assert list(tmp_path.iterdir()) == []


def test_the_import_is_light():
    code = "import sys; import omniocc.progress; print(sorted({'rich', 'numpy', 'hydra'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
