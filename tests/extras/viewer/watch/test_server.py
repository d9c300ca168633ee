"""The server as browsers and others reach it, and what it reads from folders of runs."""

import http.client
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from filelock import FileLock
from lightning.pytorch.loggers import CSVLogger
from made_runs import make_run

from omniocc.errors import UserError
from omniocc.extras.viewer.watch.files import held_locks, identity
from omniocc.extras.viewer.watch.server import Server, details, jobs, last_images, run_folders, run_states, thinned
from omniocc.progress import Status
from omniocc.runs.wandb.loggers import CSV

ROOT = Path(__file__).parents[4]
EVIL = "<img src=x onerror=alert(1)>"


@pytest.fixture
def runs(tmp_path):
    root = tmp_path / "runs"
    run = make_run(root / "ours-1")
    (run / "images").mkdir()
    (run / "images" / "val.png").write_bytes(b"\x89PNG image")
    make_run(root / EVIL.replace("/", ""))
    (tmp_path / "secret.png").write_bytes(b"secret")
    (root / "metrics.csv").write_text("secret")
    return root


@pytest.fixture
def ask(runs):
    """Return a function that asks a real server for a path, and returns status, headers and content."""
    with Server(runs, 0) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()

        def get(path, method="GET", **headers):
            connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
            connection.putrequest(method, path, skip_host="Host" in headers)
            for name, value in headers.items():
                connection.putheader(name, value)
            connection.endheaders()
            answer = connection.getresponse()
            content = answer.read()
            connection.close()
            return answer.status, dict(answer.getheaders()), content

        yield get
        server.shutdown()


def test_the_page_and_its_data(ask):
    status, headers, page = ask("/")
    assert status == 200
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert b"http" not in page.replace(b"<!doctype html>", b"")  # nothing from elsewhere
    for path in ("/page.js", "/page.css", "/icon.svg"):
        assert ask(path)[0] == 200
    runs = json.loads(ask("/api/runs")[2])["runs"]
    assert {run["id"] for run in runs} == {"ours-1", EVIL}
    run = json.loads(ask("/api/run?id=ours-1")[2])
    assert run["curves"]["train/loss"] == [[99, 2.5], [199, 2.25]]
    assert run["images"] == ["val.png"]
    status, headers, image = ask("/image?id=ours-1&name=val.png")
    assert (status, headers["Content-Type"], image) == (200, "image/png", b"\x89PNG image")


def test_html_in_names_comes_as_data_and_the_page_sets_texts_only(ask):
    _, headers, content = ask("/api/runs")
    assert headers["Content-Type"] == "application/json"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert EVIL in [run["id"] for run in json.loads(content)["runs"]]
    script = ask("/page.js")[2].decode()
    for way in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", 'setAttribute("on'):
        assert way not in script


ELSEWHERE = """
/secret.png /../secret.png /%2e%2e/secret.png /static/page.html //etc/passwd
/image?id=ours-1&name=../../../secret.png /image?id=ours-1&name=..%2F..%2F..%2Fsecret.png
/image?id=..&name=secret.png /image?id=../../&name=secret.png /image?id=ours-1 /image
/image?id=ours-1&name=/etc/passwd /image?id=ours-1&name=val.png%00
/api/run?id= /api/run?id=. /api/run?id=../runs/ours-1 /api/run?id=stages /api/run /api
"""


@pytest.mark.parametrize("path", ELSEWHERE.split())
def test_nothing_else_can_be_read(ask, path):
    status, headers, content = ask(path)
    assert status == 404
    assert content == b"there is nothing here"
    assert headers["Content-Type"].startswith("text/plain")


def test_links_to_other_places_are_not_followed(ask, runs):
    run = make_run(runs / "linked")
    (run / "images").symlink_to(runs.parent)
    (runs / "ours-1" / "images" / "link.png").symlink_to(runs.parent / "secret.png")
    for path in ("/image?id=linked&name=secret.png", "/image?id=ours-1&name=link.png"):
        assert ask(path)[0] == 404
    assert json.loads(ask("/api/run?id=linked")[2])["images"] == []


@pytest.mark.parametrize(
    ("status", "hosts"),
    [
        (200, ["127.0.0.1", "127.0.0.1:9999", "localhost:8080", "localhost"]),
        (403, ["", "evil.example", "evil.example:8080", "127.0.0.1.evil.example", "localhost.evil.example:80"]),
        (403, ["evil.example#localhost", "127.0.0.1:80@evil.example"]),
    ],
)
def test_pages_of_other_names_get_nothing(ask, status, hosts):
    assert [ask("/api/runs", Host=host)[0] for host in hosts] == [status] * len(hosts)


def test_nothing_can_be_changed(ask):
    for method in ("POST", "PUT", "DELETE"):
        assert ask("/api/runs", method)[0] == 501


def test_it_listens_to_this_machine_alone(runs):
    with Server(runs, 0) as server:
        assert server.server_address[0] == "127.0.0.1"
        assert server.socket.family == socket.AF_INET


def test_a_taken_port_and_a_missing_folder_are_a_line(runs, tmp_path):
    with Server(runs, 0) as server, pytest.raises(UserError, match=r"port=\d+ is taken by another program") as caught:
        Server(runs, server.server_port)
    assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match=r"there is no such folder; .*python src/train\.py"):
        Server(tmp_path / "nothing", 0)


def test_a_damaged_run_is_said(ask, runs):
    make_run(runs / "bad", "step,train/loss\n9,three\n")
    assert json.loads(ask("/api/run?id=bad")[2]) == {"curves": {}, "images": []}
    (bad,) = (run for run in json.loads(ask("/api/runs")[2])["runs"] if run["id"] == "bad")
    path = runs / "bad" / "csv" / "version_0" / "metrics.csv"
    assert bad["problem"] == f"left out: {path} is damaged: train/loss is 'three'"


def test_ctrl_c_ends_it_cleanly(runs):
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # may be ignored behind a shell
    code = (
        f"from pathlib import Path; from omniocc.extras.viewer.watch.server import watch; watch(Path({str(runs)!r}), 0)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    command, pipe = [sys.executable, "-c", f"{heard}; {code}"], subprocess.PIPE
    process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment)
    assert process.stdout is not None
    assert "ssh -L" in process.stdout.readline()
    assert "follows" in process.stdout.readline()
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0
    assert errors == ""


def states(runs):
    return {state.id: state for state in run_states(runs)}


def test_runs_and_stages_are_found_and_other_folders_are_not(tmp_path):
    make_run(tmp_path / "ours-1")
    make_run(tmp_path / "stages" / "depth-2")
    make_run(tmp_path / "stages" / "sketch-3")
    make_run(tmp_path / ".hidden")
    make_run(tmp_path / "of-another-encoding-\udcff")
    (tmp_path / "report").mkdir()
    (tmp_path / "note.txt").touch()
    assert list(run_folders(tmp_path)) == ["ours-1", "stages/depth-2", "stages/sketch-3"]
    assert run_folders(tmp_path / "nothing") == {}
    found = states(tmp_path)
    kinds = [(found[name].stage, found[name].steps) for name in ("ours-1", "stages/depth-2", "stages/sketch-3")]
    assert kinds == [("occupancy", 1000), ("depth", 500), ("sketch", None)]
    assert found["ours-1"].step == 200
    assert found["ours-1"].score == ("val/rayiou", 0.375)


def test_the_time_left_follows_from_the_rate_since_the_last_start(tmp_path):
    make_run(tmp_path / "a", age_s=10.0)  # 100 steps in 100 s: 800 steps are left, 10 s of them are over
    make_run(tmp_path / "b", "step,train/loss\n99,2.5\n")
    assert states(tmp_path)["a"].left in ("13:09 min", "13:10 min")
    assert states(tmp_path)["b"].left == ""
    resumed = make_run(tmp_path / "c")
    version = resumed / "csv" / "version_1"
    version.mkdir()
    (version / "metrics.csv").write_text("step,train/loss\n249,2\n499,1\n")  # twice as fast
    now_s = time.time()
    os.utime(version / "metrics.csv", (now_s, now_s))
    os.utime(version, (now_s - 125, now_s - 125))
    assert states(tmp_path)["c"].left in ("4:09 min", "4:10 min")
    assert states(tmp_path)["c"].step == 500


def test_a_run_is_in_progress_while_its_lock_is_held_finished_with_figures_and_else_stopped(tmp_path):
    run = make_run(tmp_path / "a", age_s=600)
    assert states(tmp_path)["a"].state == "stopped"
    assert states(tmp_path)["a"].left == ""
    with FileLock(run / ".lock"):
        if identity(run / ".lock") not in held_locks():
            pytest.skip("this kernel does not show locks in /proc/locks")
        assert states(tmp_path)["a"].state == "in progress"
        assert states(tmp_path)["a"].left in ("3:19 min", "3:20 min")
    assert states(tmp_path)["a"].state == "stopped"
    (run / "metrics.json").write_text("{}")
    assert states(tmp_path)["a"].state == "finished"
    sketch = make_run(tmp_path / "stages" / "sketch-2", age_s=600)
    (sketch / "candidates-1").mkdir()
    assert states(tmp_path)["stages/sketch-2"].state == "stopped"
    (sketch / "candidates-1" / "metrics.json").touch()
    assert states(tmp_path)["stages/sketch-2"].state == "finished"
    recent = make_run(tmp_path / "b", age_s=60)  # in another container, whose locks are not seen
    assert states(tmp_path)[recent.name].state == "in progress"


def test_the_files_of_the_logger_itself_are_followed_line_by_line(tmp_path):
    logger = CSVLogger(tmp_path / "run", name=CSV, flush_logs_every_n_steps=1)
    logger.log_metrics({"train/loss": 4.0}, 9)
    assert states(tmp_path)["run"].step == 10
    logger.log_metrics({"val/rayiou": 0.25, "val/voxel/iou": float("nan")}, 19)
    assert details(tmp_path / "run")["curves"] == {"train/loss": [(9, 4.0)], "val/rayiou": [(19, 0.25)]}
    assert states(tmp_path)["run"].score == ("val/rayiou", 0.25)


def test_a_damaged_run_does_not_hide_the_others(tmp_path):
    make_run(tmp_path / "bad", "step,train/loss\n9,three\n")
    make_run(tmp_path / "good")
    (tmp_path / "good" / "config.yaml").write_text("{not: [yaml")
    assert states(tmp_path)["bad"].state == "unreadable"
    assert states(tmp_path)["good"].steps is None


def test_files_that_have_not_changed_are_not_read_again_however_many_runs_there_are(tmp_path, monkeypatch):
    for number in range(300):
        make_run(tmp_path / f"ours-{number}")
    run_states(tmp_path)
    opened = []
    read = Path.open
    monkeypatch.setattr(
        Path, "open", lambda path, *options, **more: opened.append(path) or read(path, *options, **more)
    )
    run_states(tmp_path)
    assert [path for path in opened if path.name == "config.yaml"] == []
    (tmp_path / "ours-7" / "config.yaml").write_text("stages: {occupancy: {max_steps: 7}}")
    assert states(tmp_path)["ours-7"].steps == 7
    assert [path for path in opened if path.name == "config.yaml"][1:] == [tmp_path / "ours-7" / "config.yaml"]


def test_a_job_whose_status_is_damaged_does_not_hide_the_others(tmp_path):
    (tmp_path / "sweeps").mkdir()
    for name, text in {"a": '{"state": "running", "title": "x", "total": 9, "rate_hz": "fast"}', "b": "[]"}.items():
        (tmp_path / "sweeps" / f"{name}.status.json").write_text(text)
    (tmp_path / "sweeps" / "c.status.json").mkdir()
    assert [job["status"].partition(":")[0] for job in jobs(tmp_path)] == ["its status cannot be read"] * 3


def test_nothing_is_written(tmp_path):
    run = make_run(tmp_path / "a")
    (run / "images").mkdir()
    (run / "images" / "one.png").touch()

    def stamps():
        return {path: (path.stat().st_mtime_ns, path.stat().st_ctime_ns) for path in tmp_path.rglob("*")}

    before = stamps()
    run_states(tmp_path)
    details(run)
    jobs(tmp_path)
    assert stamps() == before


def test_the_newest_images_come_first_and_links_are_left_out(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for k in range(9):
        (folder / f"val-{k}.png").touch()
        os.utime(folder / f"val-{k}.png", (100 - k, 100 - k))
    (folder / "note.txt").touch()
    (folder / "link.png").symlink_to("/etc/hostname")
    assert last_images(tmp_path) == [f"val-{k}.png" for k in range(6)]


def test_long_curves_are_thinned_and_keep_their_last_point():
    points = thinned({step: step / 2 for step in range(0, 25030, 10)})
    assert len(points) <= 1000
    assert points[-1] == (25020, 12510.0)
    assert {b[0] - a[0] for a, b in itertools.pairwise(points)} == {30}
    assert thinned({3: 1.0}) == [(3, 1.0)]


def test_jobs_of_multiruns_say_what_they_do(tmp_path):
    folder = tmp_path / "sweeps" / "2026-01-01"
    folder.mkdir(parents=True)
    status = Status("running", "depth train", 3, 10, "steps", rate_hz=2.0, left_s=3.5)
    (folder / "0_ours.status.json").write_text(json.dumps(vars(status)))
    (folder / "1_mono.status.json").write_text("{")
    (folder / "2_old.status.json").write_text(json.dumps(vars(status)))
    os.utime(folder / "2_old.status.json", (0, 0))
    first, second = jobs(tmp_path)
    assert first == {"job": "0_ours", "status": "depth train: 3/10 steps, 2.0 steps/s, 0:03 min left"}
    assert "cannot be read" in second["status"]
