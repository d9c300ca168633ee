import pickle
import re
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar

import fsspec
import numpy as np
import pytest
import torch
from fake_scene import FakeWorld

from omniocc.data import DataError, SceneReader
from omniocc.data.dataset import WindowDataset
from omniocc.data.labels.voxels import VoxelCache
from omniocc.data.store import files
from omniocc.data.store.check import check_scene
from omniocc.data.store.files import Files, read_members
from omniocc.geometry import Cuboid
from omniworld import VirtualWorld

GRID = Cuboid(shape=(6, 5, 4), x_m=(-20.0, 20.0), y_m=(-20.0, 20.0), height_m=(-2.8, 3.6))


class RangeHandler(SimpleHTTPRequestHandler):
    """Serves byte ranges, which the standard library's server does not."""

    ranges = True
    asked: ClassVar[list[tuple[str, str]]] = []

    def do_GET(self):
        wanted = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        self.asked.append((self.path, self.headers.get("Range", "")))
        if not (self.ranges and wanted):
            super().do_GET()
            return
        with open(self.translate_path(self.path), "rb") as file:
            content = file.read()
        begin, end = int(wanted[1]), int(wanted[2] or len(content) - 1)
        part = content[begin : end + 1]
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {begin}-{begin + len(part) - 1}/{len(content)}")
        self.send_header("Content-Length", str(len(part)))
        self.end_headers()
        self.wfile.write(part)

    def log_message(self, *_):
        pass


class WholeHandler(RangeHandler):
    ranges = False


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    world = FakeWorld(tmp_path_factory.mktemp("world"))
    world.prepare()
    return world


def serve(folder, handler, port=0):
    server = ThreadingHTTPServer(("127.0.0.1", port), partial(handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server, f"http://127.0.0.1:{server.server_port}"


@pytest.fixture(params=["memory", "http"])
def url(request, world):
    if request.param == "memory":
        store = fsspec.filesystem("memory")
        store.put(str(world.root), "/bucket/data", recursive=True)
        yield "memory://bucket/data"
        store.rm("/bucket", recursive=True)
        return
    server, url = serve(world.root, RangeHandler)
    yield url
    server.shutdown()
    server.server_close()


def test_samples_are_the_same_from_a_store(world, url, tmp_path):
    local = VoxelCache(tmp_path / "local", GRID)
    local.prepare(world.scenes("train"))
    there = FakeWorld(url, cache=str(tmp_path / "cache"))
    assert there.missing() == []
    there.prepare()
    scenes = there.scenes("train")
    cache = VoxelCache(there.folder, GRID)
    cache.prepare(scenes)
    here = WindowDataset(world.scenes("train"), local, 2)
    remote = pickle.loads(pickle.dumps(WindowDataset(scenes, cache, 2)))
    assert len(remote) == len(here) == 8
    for a, b in zip(here[5], remote[5], strict=True):
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b
    assert check_scene(scenes[0], 4, 0.5) == []
    assert cache.folder.is_relative_to(tmp_path / "cache")


def test_members_side_by_side_are_one_request(world):
    server, url = serve(world.root, RangeHandler)
    reader = SceneReader(f"{url}/{world.name}/train-000-downtown")
    assert len(reader.index.shard) == 4
    RangeHandler.asked.clear()
    names = [f"rgb{k}.jpg" for k in range(6)]
    assert reader.read(2, names) == world.scenes("train")[0].read(2, names)
    assert len([path for path, span in RangeHandler.asked if span]) == 1
    server.shutdown()
    server.server_close()


def test_a_server_without_byte_ranges_is_named(world):
    server, url = serve(world.root, WholeHandler)
    reader = SceneReader(f"{url}/{world.name}/train-000-downtown")
    with pytest.raises(DataError, match=r"train-000-downtown/frames-001\.tar: .*byte ranges"):
        reader.read(1, ["rgb0.jpg"])
    server.shutdown()
    server.server_close()


def test_damage_in_a_store_is_named(world):
    store = fsspec.filesystem("memory")
    store.put(str(world.root), "/harmed", recursive=True)
    place = f"/harmed/{world.name}/train-000-downtown"
    reader = SceneReader(f"memory:/{place}")
    raw = bytearray(store.cat(f"{place}/frames-000.tar"))
    raw[reader.index.offset[0, 3] + 9] ^= 1
    store.pipe(f"{place}/frames-000.tar", bytes(raw))
    with pytest.raises(DataError, match=r"frame 0.*rgb2\.jpg.*checksum.*[Cc]opy"):
        reader.read(0, ["rgb2.jpg"])
    assert any(
        "frames-000.tar: scene 'train-000-downtown': its checksum" in line for line in check_scene(reader, 4, 0.5)
    )
    store.rm("/harmed", recursive=True)


def test_nothing_is_written_to_a_store(tmp_path):
    world = FakeWorld("memory://empty/data", cache=str(tmp_path))
    with pytest.raises(DataError, match=r"4 scenes.*missing.*local.*data\.source\.root"):
        world.prepare()
    with pytest.raises(ValueError, match=r"root.*memory://empty.*cache"):
        FakeWorld("memory://empty")
    gone = VirtualWorld.reader(world, world.plans[0])
    with pytest.raises(DataError, match=r"memory://empty/data/.*meta\.json: .*missing"):
        len(gone)


def test_read_members_against_slices(tmp_path):
    content = np.random.default_rng(0).bytes(60_000)
    (tmp_path / "file").write_bytes(content)
    offsets, sizes = [40_000, 0, 700, 8_000, 59_990], [5, 700, 100, 9_000, 100]
    parts = read_members(Files(tmp_path), "file", offsets, sizes)
    assert parts == [content[begin : begin + size] for begin, size in zip(offsets, sizes, strict=True)]
    assert len(parts[-1]) == 10


class Store:
    """A store whose requests fail with the given errors, one after the other, and then answer; and a clock."""

    def __init__(self, errors, monkeypatch):
        self.errors, self.now_s, self.requests = list(errors), 0.0, 0
        monkeypatch.setattr(files.time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(files.time, "sleep", self.sleep)

    def sleep(self, seconds):
        self.now_s += seconds

    def request(self):
        self.requests += 1
        if self.errors:
            raise self.errors.pop(0)
        return b"content"


@pytest.fixture
def answered(monkeypatch):
    """Stores that answered before."""
    monkeypatch.setattr(files, "_answered", {"s3://bucket"})


@pytest.mark.usefixtures("answered")
def test_a_store_that_stops_answering_is_asked_again_and_says_so_once(monkeypatch, capsys):
    store = Store([ConnectionError("cut"), TimeoutError(), OSError(5, "no route")], monkeypatch)
    assert files.request_with_retries(store.request, "s3://bucket/data/scene/meta.json") == b"content"
    assert store.now_s == 1 + 2 + 4
    assert capsys.readouterr().err.splitlines() == [
        "s3://bucket/data/scene/meta.json: no answer (ConnectionError: cut); trying again for 300 s",
        "s3://bucket/data/scene/meta.json: answers again after 7 s",
    ]


@pytest.mark.usefixtures("answered")
def test_a_store_that_stays_away_ends_with_its_error_after_some_minutes(monkeypatch):
    store = Store([ConnectionError(f"cut {number}") for number in range(100)], monkeypatch)
    with pytest.raises(ConnectionError, match="cut"):
        files.request_with_retries(store.request, "s3://bucket/meta.json")
    assert store.now_s == files.RETRY_FOR_S
    assert 20 < store.requests < 30


@pytest.mark.usefixtures("answered")
@pytest.mark.parametrize(
    ("url", "error"),
    [
        ("s3://elsewhere/meta.json", ConnectionError("no such host")),  # it never answered: likely a wrong name
        ("s3://bucket/meta.json", FileNotFoundError("meta.json")),
        ("s3://bucket/meta.json", PermissionError("denied")),
    ],
)
def test_what_asking_again_cannot_mend_is_raised_at_once(url, error, monkeypatch):
    store = Store([error], monkeypatch)
    with pytest.raises(type(error)):
        files.request_with_retries(store.request, url)
    assert store.requests == 1


def test_a_reader_goes_on_when_a_server_comes_back(world, capsys):
    server, url = serve(world.root, RangeHandler)
    reader = SceneReader(f"{url}/{world.name}/train-000-downtown")
    first = reader.read(0, ["rgb0.jpg"])
    server.shutdown()
    server.server_close()
    there = threading.Timer(0.5, lambda: serve(world.root, RangeHandler, server.server_port))
    there.start()
    assert reader.read(1, ["rgb0.jpg"]) != first
    assert "frames-001.tar: no answer (ClientConnector" in capsys.readouterr().err
    there.join()


def test_a_missing_package_is_named_with_the_line_that_installs_it(monkeypatch):
    def missing(url):
        raise ImportError("Install s3fs to access S3")

    monkeypatch.setattr(fsspec.core, "url_to_fs", missing)
    with pytest.raises(DataError, match=r"s3://bucket/data: .*pip install .*'\.\[s3\]'"):
        Files("s3://bucket/data")


def test_files_are_read_whole_from_stores_with_arguments_in_an_order_of_their_own(monkeypatch):
    """The second argument of s3fs is a version: ends given by place would leave the beginning out."""
    store = fsspec.filesystem("memory")
    store.pipe("/versions/meta.json", b"0123456789")
    plain = type(store).cat_file
    versioned = lambda self, path, version_id=None, start=None, end=None: plain(self, path, start, end)  # noqa: E731
    monkeypatch.setattr(type(store), "cat_file", versioned)
    assert Files("memory://versions").read("meta.json") == b"0123456789"
