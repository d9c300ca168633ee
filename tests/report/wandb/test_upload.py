import json
import os

import pytest
from filelock import FileLock
from offline_file import files_of, history, runs_in

from omniocc.report.wandb.upload import log_report, main, pending_runs, remove_half_record, whole_bytes


def offline_run(folder, number=1):
    path = folder / "wandb" / f"offline-run-20260101_00000{number}-x" / "run-x.wandb"
    path.parent.mkdir(parents=True)
    path.touch()
    return path


def test_runs_stages_and_what_a_resumed_run_adds_wait(tmp_path):
    run, stage = offline_run(tmp_path / "mono-1"), offline_run(tmp_path / "stages" / "depth-2")
    assert pending_runs(tmp_path) == [run, stage]
    run.with_name("run-x.wandb.synced").touch()
    more = offline_run(tmp_path / "mono-1", 2)
    assert pending_runs(tmp_path) == [more, stage]


def test_a_run_in_progress_is_left_alone(tmp_path):
    run = offline_run(tmp_path / "mono-1")
    with FileLock(run.parents[2] / ".lock"):
        assert pending_runs(tmp_path) == []
    assert pending_runs(tmp_path) == [run]


def test_without_a_login_there_is_one_clear_line(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("WANDB_API_KEY", raising=False)
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    killed_at_once = offline_run(tmp_path / "mono-0")
    main(["--runs", str(tmp_path)])
    assert "nothing waits for upload" in capsys.readouterr().out
    offline_run(tmp_path / "mono-1").write_bytes(HEADER + record(20))
    with pytest.raises(SystemExit, match=r"1 files wait in .*: run `wandb login`"):
        main(["--runs", str(tmp_path)])
    assert killed_at_once.read_bytes() == b""


HEADER, BLOCK = b":W&B" + bytes(3), 32768


def record(length, kind=1):
    """A record in LevelDB's log format: checksum, length, kind, content."""
    return bytes(4) + length.to_bytes(2, "little") + bytes([kind]) + b"x" * length


def test_half_a_record_at_the_end_is_cut_off(tmp_path):
    short = HEADER + record(20)
    first = record(BLOCK - len(short) - 7, kind=2)
    parted = short + first + record(100, kind=4)
    padded = parted + record(BLOCK - 107 - 7 - 3) + bytes(3)  # too little of the block is left for a record
    content = padded + record(50)
    ends = {len(short), len(parted), len(padded) - 3, len(content)}
    for cut in {5, 7, 20, *(end + more for end in ends for more in (-1, 0, 1, 8))}:
        assert whole_bytes(content[:cut]) == max((end for end in ends if end <= cut), default=0), cut
    path = tmp_path / "run-x.wandb"
    path.write_bytes(content[:-1])
    remove_half_record(path)
    assert path.read_bytes() == content[:-1], "written a moment ago"
    os.utime(path, (0, 0))  # an old file
    remove_half_record(path)
    assert path.read_bytes() == padded[:-3]


def test_the_tables_of_a_report_are_a_run_of_their_own(tmp_path):
    (tmp_path / "sketch.csv").write_text("row,method,paper\nmono,Mono,0.42\nours,Ours,0.47\n")
    assert log_report(tmp_path, "p")
    assert not log_report(tmp_path, "p")
    (path,) = files_of(tmp_path)
    (run,) = runs_in(path)
    assert (run.project, run.job_type) == ("p", "report")
    (row,) = [row for row in history(path) if "paper/sketch" in row]
    table = json.loads((path.parent / "files" / row["paper/sketch"]["path"]).read_text())
    assert table["columns"] == ["row", "method", "paper"]
    assert table["data"] == [["mono", "Mono", "0.42"], ["ours", "Ours", "0.47"]]
