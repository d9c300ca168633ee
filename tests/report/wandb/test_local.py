"""Links to all W&B runs in one folder, and the viewer on it."""

import fcntl
import os
import pty
import re
import select
import shutil
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

import omniocc
from omniocc.report.wandb.local import main, renew_links
from omniocc.report.wandb.upload import pending_runs


def run(folder, kind="offline-run", second=1):
    path = folder / "wandb" / f"{kind}-20260101_00000{second}-abcd" / "run-abcd.wandb"
    (path.parent / "files").mkdir(parents=True)
    path.write_text(folder.name)
    (folder / "wandb" / "latest-run").unlink(missing_ok=True)
    (folder / "wandb" / "latest-run").symlink_to(path.parent.name)
    return path


def links(folder):
    return {str(path.relative_to(folder)): path.resolve() for path in folder.glob("*/*")}


def test_runs_and_stages_are_linked_under_their_names(tmp_path):
    mono, stage = run(tmp_path / "mono-0123"), run(tmp_path / "stages" / "depth-4567", "run", 2)
    again = run(tmp_path / "mono-0123", second=3)
    folder = renew_links(tmp_path)
    assert folder == tmp_path / "leet"
    assert links(folder) == {
        "run-20260101_000001-mono-0123/run-mono-0123.wandb": mono,
        "run-20260101_000001-mono-0123/files": mono.parent / "files",
        "run-20260101_000002-depth-4567/run-depth-4567.wandb": stage,
        "run-20260101_000002-depth-4567/files": stage.parent / "files",
        "run-20260101_000003-mono-0123/run-mono-0123.wandb": again,
        "run-20260101_000003-mono-0123/files": again.parent / "files",
    }
    assert all(not os.readlink(path).startswith("/") for path in folder.glob("*/*")), "the folder can be moved"
    assert pending_runs(tmp_path) == [mono, again], "links are not uploaded"


def test_links_are_kept_current(tmp_path):
    run(tmp_path / "mono-0123")
    folder = renew_links(tmp_path)
    shutil.rmtree(tmp_path / "mono-0123")
    newer = run(tmp_path / "ours-89ab", second=4)
    assert renew_links(tmp_path) == folder
    assert renew_links(tmp_path) == folder
    assert links(folder) == {
        "run-20260101_000004-ours-89ab/run-ours-89ab.wandb": newer,
        "run-20260101_000004-ours-89ab/files": newer.parent / "files",
    }
    assert [path.name for path in folder.iterdir()] == ["run-20260101_000004-ours-89ab"]


def test_without_runs_or_a_terminal_there_is_one_line(tmp_path):
    with pytest.raises(SystemExit, match=r"holds no W&B run; training writes them unless logger\.mode=disabled"):
        main(["--runs", str(tmp_path)])
    run(tmp_path / "mono-0123")
    with pytest.raises(SystemExit, match=f"the viewer needs a terminal; there: wandb leet {tmp_path / 'leet'}"):
        main(["--runs", str(tmp_path)])


@pytest.mark.slow
def test_the_viewer_shows_a_run_on_a_pseudo_terminal(tmp_path, monkeypatch):
    import wandb

    monkeypatch.setenv("WANDB_SILENT", "true")
    (tmp_path / "mono-0123").mkdir()
    with wandb.init(dir=tmp_path / "mono-0123", id="abcd", name="mono-0123", project="p", mode="offline") as made:
        made.log({"train/loss": 2.5})
        made.summary["label/rayiou"] = 0.75
    wandb.teardown()
    screen, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 45, 150, 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": str(Path(omniocc.__file__).parents[1])}
    command = [sys.executable, "-m", "omniocc.report.wandb.local", "--runs", str(tmp_path)]
    viewer = subprocess.Popen(
        command,
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env=environment | {"HOME": str(tmp_path)},
        start_new_session=True,
    )
    os.close(terminal)
    try:
        shown, end = "", time.monotonic() + 90
        wanted = ("mono-0123", "train/loss", "label/rayiou", "Finished")
        while time.monotonic() < end and not all(word in shown for word in wanted):
            if not select.select([screen], [], [], 1)[0]:
                continue
            shown += re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", os.read(screen, 65536).decode("utf-8", "replace"))
        assert [word for word in wanted if word not in shown] == []
        os.write(screen, b"q")
        assert viewer.wait(timeout=30) == 0
    finally:
        if viewer.poll() is None:
            viewer.kill()
        os.close(screen)
