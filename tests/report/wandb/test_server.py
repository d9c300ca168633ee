"""Online runs, uploads and the dashboard, against a stand-in of a W&B server on this machine."""

import json
import os
import socket
import struct
from importlib.util import find_spec

import numpy as np
import pytest
import wandb
from offline_file import STEP, files_of
from wandb_server import API_KEY, wandb_server

from omniocc.errors import UserError
from omniocc.report.wandb import dashboard, upload
from omniocc.runs.wandb import Loggers
from omniocc.runs.wandb.loggers import check_login, finish, run_id, wandb_of
from omniocc.runs.wandb.media import MediaItem

pytestmark = pytest.mark.whole_runs

CONFIG = {"name": "mono", "seed": 3, "model": {"sketch": {"_target_": "omniocc.model.sketch.Dense"}}}


@pytest.fixture
def address(tmp_path, monkeypatch):
    """Return a function that makes an address the W&B server, with a login of its own; W&B keeps nothing of it."""
    for name in ("CONFIG_DIR", "CACHE_DIR", "DATA_DIR"):
        monkeypatch.setenv(f"WANDB_{name}", str(tmp_path / "wandb" / name))
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    monkeypatch.setenv("WANDB_API_KEY", API_KEY)
    monkeypatch.delenv("WANDB_MODE", raising=False)  # Lightning leaves it set after an offline run of an earlier test
    monkeypatch.setenv("WANDB_SILENT", "false")  # `Loggers` sets it unless it is set
    monkeypatch.chdir(tmp_path)  # `wandb sync` writes its own log here

    def use(url):
        wandb.teardown()  # W&B reads its settings once
        monkeypatch.setenv("WANDB_BASE_URL", url)

    yield use
    wandb.teardown()


@pytest.fixture
def server(address):
    with wandb_server() as found:
        address(found.url)
        yield found


def made_run(folder, mode):
    folder.mkdir(parents=True)
    loggers = Loggers(mode, "p", "tiny", ["x"]).build(folder, CONFIG, "occupancy")
    for logger in loggers:
        logger.log_metrics({"train/loss": 2.5}, 1)
        logger.log_metrics({"test/rayiou": 0.5, "test/rayiou/Road": 0.25}, 2)
    for curves in wandb_of(loggers):
        curves.log_media({"test/bev": [MediaItem(np.zeros((4, 4, 3), np.uint8), "scene/0")]}, 2)
    finish(loggers)
    wandb.teardown()
    os.environ.pop("WANDB_MODE", None)  # Lightning sets it for an offline run
    return folder


def assert_arrived(server, folder):
    name = run_id(folder)
    sent, config = server.runs[name], json.loads(server.runs[name]["config"])
    assert (sent["project"], sent["groupName"], sent["jobType"]) == ("p", "tiny", "occupancy")
    assert (sent["displayName"], sent["tags"]) == (folder.name, ["mono", "x"])
    assert {key: config[key]["value"] for key in ("row", "seed", "slots")} == {
        "row": "mono",
        "seed": 3,
        "slots": {"sketch": "dense"},
    }
    rows = server.history(name)
    assert [(row[STEP], row["train/loss"]) for row in rows if "train/loss" in row] == [(1, 2.5)]
    assert not any("test/rayiou" in row for row in rows)
    summary = server.summary(name)
    assert (summary["test/rayiou"], summary["test/rayiou/Road"]) == (0.5, 0.25)
    (image,) = summary["test/bev"]["filenames"]
    assert server.files[f"{name}/{image}"].startswith(b"\xff\xd8"), "a JPEG"
    table = json.loads(server.files[f"{name}/{summary['tables/by_class']['path']}"])
    assert table["data"] == [["Road", 0.25]]
    assert server.unknown == []


def line_of(main, *arguments):
    """Return the line that a script ends with."""
    with pytest.raises(SystemExit) as error:
        main([str(argument) for argument in arguments])
    assert isinstance(error.value.code, str)
    assert "\n" not in error.value.code
    return error.value.code


@pytest.mark.slow(3)
def test_an_online_run_is_on_the_server_when_it_ends(server, tmp_path):
    assert_arrived(server, made_run(tmp_path / "mono-0123", "online"))


@pytest.mark.slow(4)
def test_offline_runs_are_uploaded_once(server, tmp_path, capfd):
    runs = tmp_path / "runs"
    made = [made_run(runs / "mono-0123", "offline"), made_run(runs / "stages" / "depth-4567", "offline")]
    assert server.runs == {}
    upload.main(["--runs", str(runs)])
    for folder in made:
        assert_arrived(server, folder)
    before = {name: len(server.history(name)) for name in server.runs}
    capfd.readouterr()
    upload.main(["--runs", str(runs)])
    assert capfd.readouterr().out == f"{runs}: nothing waits for upload\n"
    assert {name: len(server.history(name)) for name in server.runs} == before


@pytest.mark.slow(8)
def test_what_was_not_uploaded_waits_and_says_why(server, tmp_path, capfd):
    """The server refuses both runs at first; the second was killed, so its file ends within a record."""
    whole, killed = (made_run(tmp_path / name, "offline") for name in ("mono-0123", "ours-4567"))
    (path,) = files_of(killed)
    os.truncate(path, path.stat().st_size - 5)
    server.refused["UpsertBucket"] = 403
    assert line_of(upload.main, "--runs", tmp_path).startswith("2 of 2 files still wait, for the reasons above")
    assert "refused here" in capfd.readouterr().err
    server.refused.clear()
    line = line_of(upload.main, "--runs", tmp_path)
    assert line == f"1 of 2 files still wait, for the reasons above; the first is {path}", "it may be in progress"
    assert "incomplete record" in capfd.readouterr().err
    assert_arrived(server, whole)
    os.utime(path, (0, 0))  # an old file
    upload.main(["--runs", str(tmp_path)])
    assert server.history(run_id(killed))[-1][STEP] == 2
    assert upload.pending_runs(tmp_path) == []


def test_a_setting_that_is_no_address_is_one_line(address):
    address("here")
    with pytest.raises(UserError, match=r"x: the W&B server refused .*WANDB_BASE_URL.*: .*valid URL.*'here'") as error:
        check_login("x")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("status", [401, 500, None])
def test_without_a_server_that_answers_there_is_one_line(status, address, tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_HTTP_TIMEOUT", "1")
    path = tmp_path / "runs" / "mono-0123" / "wandb" / "offline-run-20260101_000001-x" / "run-x.wandb"
    path.parent.mkdir(parents=True)
    path.write_bytes(b":W&B" + bytes(3) + struct.pack("<IHB", 0, 1, 1) + b"x")
    with wandb_server() as server, socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))  # and does not listen
        url = server.url if status else f"http://127.0.0.1:{unused.getsockname()[1]}"
        server.refused["Viewer"] = status or 0
        address(url)
        reason = f"the W&B server refused the login or gave no answer .*{url}"
        with pytest.raises(SystemExit, match=f"1 files wait in {tmp_path / 'runs'}: {reason}"):
            upload.main(["--runs", str(tmp_path / "runs")])
        if status == 401:  # the other two wait for the time limit
            with pytest.raises(UserError, match=f"logger.mode=online needs a W&B server: {reason}"):
                Loggers("online", "p", None, []).build(tmp_path, CONFIG, "occupancy")
            with pytest.raises(SystemExit, match=f"not saved, .*: {reason}"):
                dashboard.main([])
    assert upload.pending_runs(tmp_path) == [path]


@pytest.mark.skipif(find_spec("wandb_workspaces") is None, reason="needs the extra 'dashboard'")
def test_the_dashboard_is_saved_or_says_why_not(server, tmp_path, capsys):
    runs = tmp_path / "runs"
    (runs / "mono-0123").mkdir(parents=True)
    metrics = {"test/rayiou": 0.5, "test/rayiou/tree": 0.5, "test/rayiou_0-20m": 0.4}
    (runs / "mono-0123" / "metrics.json").write_text(json.dumps({"metrics": metrics}))
    dashboard.main(["--runs", str(runs)])
    (view,) = server.views
    assert f"dashboard {server.url}/me/omniocc?nw=" in capsys.readouterr().out
    assert (view["entityName"], view["projectName"], view["displayName"]) == ("me", "omniocc", "OmniDepth-Occ")
    sections = json.loads(view["spec"])["section"]["panelBankConfig"]["sections"]
    assert [section["name"] for section in sections] == [
        "compare rows",
        "by range",
        "by class",
        "depth and sketch",
        "images",
    ]
    dashboard.main(["--runs", str(runs), "--entity", "team", "--project", "other"])
    assert (server.views[1]["entityName"], server.views[1]["projectName"]) == ("team", "other")
    server.refused["UpsertView2"] = 403
    line = line_of(dashboard.main, "--runs", runs)
    assert line == "the W&B server did not save the dashboard to me/omniocc: refused here"
