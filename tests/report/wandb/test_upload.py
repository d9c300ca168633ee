import json
import subprocess

import pytest
from filelock import FileLock
from offline_file import files_of, history, runs_in

from omniocc.report.wandb.upload import log_report, main, waiting


def offline_run(folder, number=1):
    path = folder / "wandb" / f"offline-run-20260101_00000{number}-x" / "run-x.wandb"
    path.parent.mkdir(parents=True)
    path.touch()
    return path


def test_runs_stages_and_what_a_resumed_run_adds_wait(tmp_path):
    run, stage = offline_run(tmp_path / "mono-1"), offline_run(tmp_path / "stages" / "depth-2")
    assert waiting(tmp_path) == [run, stage]
    run.with_name("run-x.wandb.synced").touch()
    more = offline_run(tmp_path / "mono-1", 2)
    assert waiting(tmp_path) == [more, stage]


def test_a_run_in_progress_is_left_alone(tmp_path):
    run = offline_run(tmp_path / "mono-1")
    with FileLock(run.parents[2] / ".lock"):
        assert waiting(tmp_path) == []
    assert waiting(tmp_path) == [run]


def test_without_a_login_there_is_one_clear_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("omniocc.report.wandb.upload.logged_in", lambda: False)
    main(["--runs", str(tmp_path)])
    assert "nothing waits for upload" in capsys.readouterr().out
    offline_run(tmp_path / "mono-1")
    with pytest.raises(SystemExit, match=r"1 files.*wandb login"):
        main(["--runs", str(tmp_path)])


def test_all_files_go_to_wandb_in_one_command(tmp_path, monkeypatch):
    monkeypatch.setattr("omniocc.report.wandb.upload.logged_in", lambda: True)
    calls = []
    run = lambda command, check: calls.append(command) or subprocess.CompletedProcess(command, 3)  # noqa: E731
    monkeypatch.setattr("omniocc.report.wandb.upload.subprocess.run", run)
    files = [offline_run(tmp_path / "a-1"), offline_run(tmp_path / "b-2")]
    with pytest.raises(SystemExit) as error:
        main(["--runs", str(tmp_path)])
    assert error.value.code == 3
    assert calls[0][1:] == ["-m", "wandb", "sync", *map(str, files)]


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
