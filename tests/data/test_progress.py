import pytest

from omniocc.data.progress import FrameProgress, clock


def test_frames_that_were_there_do_not_count_as_fast(monkeypatch, capsys):
    now = [100.0]
    monkeypatch.setattr("omniocc.data.progress.time.monotonic", lambda: now[0])
    with FrameProgress("rendering", 1000) as progress:
        progress.advance(900)  # what an interrupted run has left
        now[0] += 20.0
        for _ in range(10):
            progress.advance()
        assert progress.rate_hz == pytest.approx(0.5)
        now[0] += 20.0
    first, last = capsys.readouterr().err.splitlines()
    assert first == "rendering: 901/1000 frames, 0.1 frames/s, 33:00 min left"
    assert last == "rendering: 910/1000 frames, 0.2 frames/s, 6:00 min left"


def test_frames_of_another_process_count_for_the_time_that_is_left(monkeypatch, capsys):
    now, finished = [100.0], [0]
    monkeypatch.setattr("omniocc.data.progress.time.monotonic", lambda: now[0])
    with FrameProgress("rendering", 100, lambda: finished[0]) as progress:
        for own in range(1, 12):
            finished[0] = own // 5 * 10  # a scene of five frames here, and one there
            now[0] += 2.0
            progress.advance()
        finished[0] = 100
        progress.advance(100 - 11)  # found there
    assert capsys.readouterr().err.splitlines() == [
        "rendering: 10/100 frames, 0.6 frames/s, 2:24 min left",
        "rendering: 100/100 frames, 0.5 frames/s",
    ]


def test_clock():
    assert [clock(value) for value in (59.9, 3599.0, 3600.0, 86399.0, 129600.0)] == [
        *("0:59 min", "59:59 min", "1:00 h", "23:59 h", "1.5 days")
    ]
