"""Secrets in URLs are refused before anything is written, and no message repeats them."""

import threading
from base64 import b64encode
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from scripts import run_script

from omniocc.config import ConfigError, compose_plain, refuse_credentials
from omniocc.data import SceneReader
from omniocc.data.source.recorded import Recorded
from omniocc.data.store.files import Files, list_folders, read_json
from omniocc.errors import UserError
from omniocc.urls import check_url, credentials_problem, redact

ROOT = Path(__file__).parents[1]
SECRETS = {
    "http://user:s3cret@host/data": "http://***@host/data",
    "https://s3cret@host": "https://***@host",
    "http://user:s3cret@[::1]:80/data": "http://***@[::1]:80/data",
    "http://user:s3c/re?t#@host/data": "http://***@host/data",
    "http://user:s3cret@x@host:80/data": "http://***@host:80/data",
    "s3://key:s3cret@bucket/data": "s3://***@bucket/data",
    "abfs://container:s3cret@account/x": "abfs://***@account/x",
    "simplecache::http://user:s3cret@host/x": "simplecache::http://***@host/x",
    "zip://a.zip::http://user:s3cret@host/x": "zip://***@host/x",
    "https://host/data?X-Amz-Signature=s3cret&token=s3cret": "https://host/data?***",
    "https://host/data?s3cret": "https://host/data?***",
    "https://host:8080/data#access_token=s3cret": "https://host:8080/data#***",
    "https://host/data;token=s3cret": "https://host/data;***",
    "rerun+http://user:s3cret@127.0.0.1:9876/proxy": "rerun+http://***@127.0.0.1:9876/proxy",
    "HTTP://user:s3cret@host": "HTTP://***@host",
}
PLAIN = (
    "s3://bucket/data",
    "s3://bucket/a@b:c",
    "http://127.0.0.1:8000/a@b",
    "http://host:80",
    "http://[::1]:80/a@b:c",
    "memory://bucket/data",
    "file:///tmp/data",
    "abfs://container@account.dfs.core.windows.net/data",
    "s3://bucket/#1",
    "images/front_?.png",
    "user:pw@host",
    "a?b=c",
    "",
    "http://host/?",
)


@pytest.mark.parametrize("url", SECRETS)
def test_secrets_are_hidden(url):
    assert redact(url) == SECRETS[url]
    problem = credentials_problem(f"key={url}")
    assert problem is not None
    assert "s3cret" not in problem
    assert "\n" not in problem


@pytest.mark.parametrize("text", PLAIN)
def test_other_texts_stay_as_they_are(text):
    assert redact(text) == text
    assert credentials_problem(text) is None


@pytest.mark.parametrize(
    ("url", "way"),
    [
        ("s3://a:b@c", "AWS_ACCESS_KEY_ID"),
        ("https://a:b@c", r"~/\.netrc"),
        ("gs://a:b@c", "GOOGLE_APPLICATION_CREDENTIALS"),
        ("az://a:b@c", "AZURE_STORAGE_ACCOUNT_KEY"),
        ("ftp://a:b@c", "FSSPEC_<PROTOCOL>"),
        ("data.source.root=s3://a:b@c", "AWS_ACCESS_KEY_ID"),
    ],
)
def test_the_way_of_the_store_is_named(url, way):
    with pytest.raises(UserError, match=way):
        check_url(url)


@pytest.mark.parametrize(
    "opened",
    [
        Files,
        SceneReader,
        Recorded,
        lambda url: list_folders(url, "meta.json"),
        lambda url: read_json(url, "a", "b"),
        partial(Recorded, splits=None, cache="cache"),
    ],
    ids=["Files", "SceneReader", "Recorded", "list_folders", "read_json", "cached"],
)
def test_nothing_opens_a_url_with_secrets(opened):
    for url in ("s3://key:s3cret@bucket/data", "https://host/a?token=s3cret", "zip://a.zip::http://user:s3cret@host/x"):
        with pytest.raises(UserError, match=r"\*\*\*") as error:
            opened(url)
        assert "s3cret" not in str(error.value)


@pytest.mark.parametrize(
    "url",
    [
        "zip://x::http://127.0.0.1:1/secret.zip",
        "simplecache::s3://bucket/data",
        "file:///tmp::memory://x",
        "ftp://host/x",
        "github://a:b@/x",
        "HTTP://host/x",
        "://x",
    ],
)
def test_chains_and_other_protocols_are_refused(url):
    with pytest.raises(UserError, match=r"not read|\*\*\*"):
        Files(url)


def test_texts_of_a_tree_are_refused_with_their_key(monkeypatch):
    monkeypatch.setenv("ROOT_URL", "http://user:s3cret@host/data")
    with pytest.raises(ConfigError) as error:
        compose_plain(ROOT / "conf", "train", ["data=recorded", "data.source.root=${oc.env:ROOT_URL}"])
    assert "data.source.root=http://***@host/data: " in str(error.value)
    assert "s3cret" not in str(error.value)
    for tree in (
        ["logger.tags=[http://a:s3cret@b]"],
        {"a": [{"b": "s3://k:s3cret@b"}]},
        {"s3://k:s3cret@b": 1},
        ("http://a?s3cret",),
    ):
        with pytest.raises(ConfigError, match=r"\*\*\*") as error:
            refuse_credentials(tree)
        assert "s3cret" not in str(error.value)
    refuse_credentials({"a": None, "b": [1, 2.0, True], "c": {"d": "s3://bucket/data"}})


COMMANDS = {
    "train.py --multirun": ["seed=0,1", "data=recorded", "data.source.cache=cache", "data.source.root={}"],
    "predict.py occupancy": ["checkpoint=demo", "recorded={}", "output=out"],
    "evaluate.py": ["best.ckpt", "data.source.root={}"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_write_and_print_no_secret(command, tmp_path):
    script, *words = command.split()
    words = [word for word in words if word in ("--multirun", "occupancy")]
    words += [word.format("http://user:s3cret@127.0.0.1:9/data") for word in COMMANDS[command]]
    done = run_script(script, *words, cwd=tmp_path)
    assert done.returncode == 1
    assert "http://***@127.0.0.1:9/data: a URL with a user" in done.stderr
    assert "~/.netrc" in done.stderr
    assert "s3cret" not in done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


class WithLogin(SimpleHTTPRequestHandler):
    """Serves whom it knows."""

    def do_GET(self):
        known = self.headers.get("Authorization") == "Basic " + b64encode("user:s3crét".encode()).decode()
        super().do_GET() if known else self.send_error(401)

    def log_message(self, *_):
        pass


def test_a_server_gets_the_login_of_the_netrc_file(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"content")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(WithLogin, directory=str(tmp_path)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    netrc = tmp_path / "netrc"
    monkeypatch.setenv("NETRC", str(netrc))
    url = f"http://127.0.0.1:{server.server_port}"
    try:
        netrc.write_text("machine elsewhere login user password other\n")
        with pytest.raises(Exception, match="401"):
            Files(url).read("file")
        netrc.write_text("machine 127.0.0.1 login user password s3crét\n", encoding="utf-8")
        assert Files(url).read("file") == b"content"
        netrc.write_text("machine\n127.0.0.1 x y\n")
        with pytest.raises(OSError, match=f"{netrc}: the file with passwords for 127.0.0.1 cannot be read"):
            Files(url)
    finally:
        server.shutdown()
        server.server_close()
