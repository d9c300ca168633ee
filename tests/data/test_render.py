"""The script `render.py`, in this process."""

import json
import re
import runpy
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from fake_scene import FakeWorld

import omniocc
from omniocc.camera import Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.data.store.files import list_folders
from omniocc.data.store.shard import META
from omniocc.draw.ranges import SKY
from omniocc.geometry import Cylinder
from omniworld.class_fractions import PUBLISHED_PERCENT
from omniworld.page import UNMEASURED, range_image, save_page

SCRIPT = Path(omniocc.__file__).parents[1] / "render.py"


class Silent(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """Serve a folder over HTTP, and give its address."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    def call(*arguments):
        common = ["preset=smoke", f"paths.data={tmp_path}", "data.source.workers=0", "frames=2", *arguments]
        monkeypatch.setattr(sys, "argv", ["render.py", *common])
        try:
            runpy.run_path(str(SCRIPT), run_name="__main__")
            code = 0
        except SystemExit as error:
            code = error.code
        return code, capsys.readouterr().out

    return call


def test_other_sources_are_not_rendered(run):
    code, _ = run("data=recorded", "data.source.root=elsewhere")
    assert "virtual world" in code


@pytest.mark.whole_runs
@pytest.mark.slow
def test_render_check_and_page(run, tmp_path):
    code, out = run("first_scene=2", "scenes=2")
    assert code == 0
    (folder,) = tmp_path.glob("virtual-*")
    assert sorted(path.name for path in folder.iterdir() if path.name[0] != ".") == [
        "train-002-industrial",
        "val-000-downtown",
    ]
    assert re.search(r"2 of 2 scenes to render, 4 frames, about 2 MB, [\d.]+ GB free\n", out)
    assert re.search(r"2 scenes, 4 frames, \d+ MB \(0\.\d\d a frame\)", out)
    assert re.search(r"the whole preset, 5 scenes, 10 frames: \d MB, at most \d:\d\d min with 1 processes", out)
    code, out = run("first_scene=2", "scenes=2", "check=true")
    assert code == 0
    assert re.search(r"Road +\d\d\.\d\d +57\.03", out)
    assert "2 scenes, 4 frames" in out
    assert "no problems found" in out
    code, out = run("page=true")
    assert code == 0
    assert "2 scenes, 3 missing" in out
    assert 100_000 < (folder / "scenes.html").stat().st_size < 5_000_000
    with serving(folder) as url:  # the page must not stand in the way of who reads the folder's list
        assert list_folders(url, META) == ["train-002-industrial", "val-000-downtown"]
    assert re.search(r"view\.html: \d\.\d MB, their voxels to turn\n", out)

    shard = folder / "val-000-downtown" / "frames-000.tar"
    raw = bytearray(shard.read_bytes())
    raw[raw.index(b"\xff\xd8\xff") + 700] ^= 1  # in the first JPEG
    shard.write_bytes(raw)
    code, out = run("check=true")
    assert code == 1
    lines = [line for line in out.splitlines() if line.startswith(str(tmp_path))]
    assert len([line for line in lines if "is missing: run without check=true" in line]) == 3
    assert any("scene 'val-000-downtown', frame 0, member 'rgb0.jpg': checksum differs" in line for line in lines)


def test_no_scene_is_a_line(run):
    code, _ = run("first_scene=5")
    assert code == "first_scene=5 scenes=None: choose some of the 5 scenes of this preset"
    code, _ = run("scenes=-1")
    assert "scenes: -1 is not a whole number from 1" in str(code)
    code, _ = run("page=true")
    assert re.search(r"none of .* scenes.* without page=true", str(code))


def test_the_page_stands_alone(tmp_path):
    world = FakeWorld(tmp_path, scenes=(2, 1, 0))
    world.prepare()
    scenes = [*world.scenes("train"), *world.scenes("val")]
    scenes[0].meta["facts"]["theme"] = "</script>"
    save_page(tmp_path / "page.html", scenes, Cylinder(shape=(8, 10, 4)), WORLD_CLASSES)
    page = (tmp_path / "page.html").read_text("utf-8")
    own = re.sub(r"data:image/(png|webp);base64,[A-Za-z0-9+/=]+", "", page)
    assert not re.search(r"//[a-z]|<link|@import|url\(|src=\"[^\"]", own)
    assert page.count("</script>") == 1
    content = json.loads(page.split("const content = ", 1)[1].split(";\nconst at", 1)[0])
    assert [scene["name"] for scene in content["scenes"]] == [
        "train-000-downtown",
        "train-001-suburb",
        "val-000-downtown",
    ]
    frames = content["scenes"][1]["frames"]
    assert [frame["number"] for frame in frames] == [0, 1, 2, 3]
    assert [frame["time"] for frame in frames] == [0.0, 0.5, 1.0, 1.5]
    assert [frame["speed"] for frame in frames] == [6.0] * 4
    for layer in ("rgb", "semantic", "range"):
        assert all(len(frame[layer]) == 6 for frame in frames)
    assert content["table"][-1] == ["This dataset", False, True, True, True, True, 12]
    assert content["authors"] == PUBLISHED_PERCENT
    assert content["scenes"][1]["weather"] == scenes[1].meta["facts"]["weather"]
    assert content["scenes"][1]["day"].startswith(("day", "dusk", "morning"))
    assert [(len(scene["pinholes"]), len(scene["frames"][0]["pinhole"])) for scene in content["scenes"]] == [(0, 0)] * 3
    assert sum(content["ours"].values()) == pytest.approx(100)
    assert content["scenes"][0]["theme"] == "</script>"
    assert content["viewer"] == "view.html"
    turned = (tmp_path / "view.html").read_text("utf-8")
    facts = json.loads(turned.split('id="facts">', 1)[1].split("</script>", 1)[0])
    assert [(frame["scene"], int(frame["frame"])) for frame in facts["frames"]] == [
        (scene["name"], frame["number"]) for scene in content["scenes"] for frame in scene["frames"]
    ]
    assert all(len(frame["truth"]) == 1 and len(frame["images"]) == 6 for frame in facts["frames"])


def test_the_page_shows_the_pinhole_dataset_beside_it(tmp_path):
    pinholes = FakeWorld(tmp_path, scenes=(1, 0, 0), frames=2)
    pinholes.rig = Rig.load("pinhole6").resized(32, 18)
    pinholes.prepare()
    world = FakeWorld(tmp_path, scenes=(1, 0, 0))
    world.prepare()
    save_page(tmp_path / "page.html", world.scenes("train"), Cylinder(shape=(8, 10, 4)), WORLD_CLASSES)
    (scene,) = json.loads(
        (tmp_path / "page.html").read_text("utf-8").split("const content = ", 1)[1].split(";\nconst at", 1)[0]
    )["scenes"]
    assert [len(frame["pinhole"]) for frame in scene["frames"]] == [6, 6, 0, 0]
    assert scene["pinholes"] == ["front left", "front", "front right", "rear left", "rear", "rear right"]


def test_range_colours():
    picture = range_image(np.array([[1.0, 8.0, 64.0, 900.0, np.inf, np.nan]]), 6)[0]
    assert picture[0, 0] > picture[0, 2]  # near: red
    assert picture[2, 2] > picture[2, 0]  # far: blue
    assert picture[1].argmax() == 1  # the middle of the logarithm: green
    assert picture[2].tolist() == picture[3].tolist()
    assert picture[4].tolist() == list(SKY)
    assert picture[5].tolist() == list(UNMEASURED)
