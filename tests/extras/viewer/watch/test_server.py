"""The server as browsers and others reach it."""

import http.client
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
from made_runs import make_run

from omniocc.errors import UserError
from omniocc.extras.viewer.watch.server import Server

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


@pytest.mark.parametrize(
    "path",
    [
        "/secret.png", "/../secret.png", "/%2e%2e/secret.png", "/static/page.html", "//etc/passwd",
        "/image?id=ours-1&name=../../../secret.png", "/image?id=ours-1&name=..%2F..%2F..%2Fsecret.png",
        "/image?id=..&name=secret.png", "/image?id=../../&name=secret.png", "/image?id=ours-1", "/image",
        "/image?id=ours-1&name=/etc/passwd", "/image?id=ours-1&name=val.png%00",
        "/api/run?id=", "/api/run?id=.", "/api/run?id=../runs/ours-1", "/api/run?id=stages", "/api/run", "/api",
    ],
)  # fmt: skip
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
    ("host", "status"),
    [
        ("127.0.0.1", 200), ("127.0.0.1:9999", 200), ("localhost:8080", 200), ("localhost", 200),
        ("evil.example", 403), ("evil.example:8080", 403), ("127.0.0.1.evil.example", 403), ("", 403),
        ("localhost.evil.example:80", 403), ("evil.example#localhost", 403), ("127.0.0.1:80@evil.example", 403),
    ],
)  # fmt: skip
def test_pages_of_other_names_get_nothing(ask, host, status):
    assert ask("/api/runs", Host=host)[0] == status


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
    assert ask("/api/run?id=bad")[0] == 500
    assert ask("/api/runs")[0] == 200


def test_ctrl_c_ends_it_cleanly(runs):
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # may be ignored behind a shell
    code = (
        f"from pathlib import Path; from omniocc.extras.viewer.watch.server import watch; watch(Path({str(runs)!r}), 0)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    process = subprocess.Popen(
        [sys.executable, "-c", f"{heard}; {code}"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    assert process.stdout is not None
    assert "ssh -L" in process.stdout.readline()
    assert "follows" in process.stdout.readline()
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 0
    assert errors == ""
