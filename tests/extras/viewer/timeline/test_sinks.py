"""Files that are whole or not there, viewers that are there or not."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import rerun as rr
from recordings import read
from rerun.chunk import RrdReader

from omniocc.errors import DataError, UserError
from omniocc.extras.viewer.timeline import sinks
from omniocc.extras.viewer.timeline.sinks import host_and_port, to_file, to_own_viewer, to_viewer

VIEWER = Path(sys.executable).with_name("rerun")


def fill(recording, count):
    for k in range(count):
        recording.set_time("frame", sequence=k)
        recording.log("values", rr.Scalars(float(k)))


def test_a_file_is_there_when_it_is_whole(tmp_path):
    path = tmp_path / "new" / "view.rrd"
    with to_file(path, "title") as recording:
        fill(recording, 3)
        assert not path.exists()
    assert [row.frame for row in read(path)["/values"]] == [0, 1, 2]
    assert len(RrdReader(path).recordings()) == 1  # from its footer, which comes last
    assert [file.name for file in path.parent.iterdir()] == ["view.rrd"]
    before = path.read_bytes()
    with pytest.raises(ZeroDivisionError), to_file(path, "title") as recording:
        fill(recording, 1 // 0)
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == ["view.rrd"]


def test_a_full_disk_is_said(tmp_path):
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000));"
        "from pathlib import Path; import numpy as np, rerun as rr;"
        "from omniocc.extras.viewer.timeline.sinks import to_file\n"
        "with to_file(Path(sys.argv[1]), 'title') as recording:\n"
        "    recording.log('points', rr.Points3D(np.random.default_rng(0).normal(size=(20000, 3))))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "v.rrd")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "DataError: cannot write" in done.stderr
    assert "files may not grow that large" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_a_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="cannot write"), to_file(tmp_path / "file" / "view.rrd", "title"):
        raise AssertionError


def test_addresses():
    for text in ("127.0.0.1:9999", "rerun+http://127.0.0.1:9999/proxy", "http://127.0.0.1:9999", "127.0.0.1:9999/"):
        assert host_and_port(text) == ("127.0.0.1", 9999)
    assert host_and_port("car.local") == ("car.local", 9876)
    assert host_and_port("[::1]:80") == ("[::1]", 80)
    for text in ("", "a b", "host:port", "host:70000", "host:0", "ftp://host", "host:1:2"):
        with pytest.raises(UserError, match=r"no address of a viewer; give host:port"):
            host_and_port(text)


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def test_without_a_listener_it_is_a_line():
    address = f"127.0.0.1:{free_port()}"
    with pytest.raises(UserError, match=f"{address}: no viewer listens") as caught, to_viewer(address, "title"):
        raise AssertionError
    assert "save=view.rrd" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_a_display_it_is_a_line(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UserError, match=r"no display.*save=view\.rrd.*connect=") as caught, to_own_viewer("title"):
        raise AssertionError
    assert "\n" not in str(caught.value)


@contextlib.contextmanager
def listening(path):
    """Run a viewer without a window, which writes what it gets to a file; give its address."""
    port = free_port()
    command = [str(VIEWER), *sinks.OWN_ARGUMENTS, "--save", str(path), "--port", str(port)]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True) as process:
        try:
            for _ in range(200):
                with contextlib.suppress(OSError):
                    socket.create_connection(("127.0.0.1", port), 1).close()
                    break
                time.sleep(0.1)
            yield f"127.0.0.1:{port}"
            time.sleep(0.5)
        finally:
            os.killpg(process.pid, signal.SIGTERM)  # the viewer is a process of the command


def test_a_running_viewer_gets_the_frames(tmp_path):
    with listening(tmp_path / "v.rrd") as address, to_viewer(address, "title") as recording:
        fill(recording, 4)
    # the file is cut short, since its writer is killed
    content = (tmp_path / "v.rrd").read_bytes()
    assert content.startswith(b"RRF")
    assert content.count(b"/values") >= 1


def listening_addresses(port):
    """Return the addresses of this machine at which something listens, as the kernel lists them (hexadecimal)."""
    rows = [
        line.split()
        for table in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{table}").read_text(encoding="utf-8").splitlines()
    ]
    places = [row[1].split(":") for row in rows[1:] if row[3] == "0A"]
    return [address for address, number in places if int(number, 16) == port]


def test_a_viewer_that_is_started_here_is_reached_from_here_alone(tmp_path, monkeypatch):
    started, port, spawn = [], free_port(), sinks.rerun_bindings.spawn

    def spawn_without_a_window(extra_args, **options):
        started.append(spawn(extra_args=[*extra_args, "--save", str(tmp_path / "v.rrd")], **options))

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("PATH", str(VIEWER.parent), prepend=":")
    monkeypatch.setattr(sinks, "PORT", port)
    monkeypatch.setattr(sinks.rerun_bindings, "spawn", spawn_without_a_window)
    try:
        with to_own_viewer("title") as recording:
            assert listening_addresses(port) == ["0100007F"]  # 127.0.0.1
            fill(recording, 3)
        time.sleep(1)
    finally:
        for process in started:
            assert os.getpgid(process) != os.getpgrp()
            os.killpg(os.getpgid(process), signal.SIGTERM)
    assert (tmp_path / "v.rrd").stat().st_size > 0
