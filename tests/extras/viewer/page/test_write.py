"""The page is one file that is complete, inert and small."""

import base64
import gzip
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files

import cv2
import numpy as np
import pytest
import torch
from made_page import CUBOID, CYLINDER, EVIL, RUNS, evidence, made_frames, made_shown, rig, write_made_page

from omniocc.errors import UserError
from omniocc.extras.viewer.page import page_path, write_page
from omniocc.extras.viewer.page.pack import Packed, direction_table
from omniocc.runs.folder import PAGE


class Scripts(HTMLParser):
    """Scripts by id or type, and what the page loads."""

    def __init__(self):
        super().__init__(convert_charrefs=False)
        self.scripts, self.loads, self.policy, self.style, self.now = {}, [], "", "", None

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.loads += [value for name, value in attributes if name in ("src", "href", "srcset")]
        assert not any(name.startswith("on") or name == "style" for name, _ in attributes)
        if tag == "script":
            self.now = found.get("id", found.get("type"))
        if tag == "style":
            self.now = "style"
        if tag == "meta" and "http-equiv" in found:
            self.policy = found["content"]

    def handle_endtag(self, tag):
        self.now = None

    def handle_data(self, data):
        if self.now:
            self.scripts[self.now] = self.scripts.get(self.now, "") + data


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Scripts:
    parser = Scripts()
    parser.feed(write_made_page(tmp_path_factory.mktemp("page") / "made.html").read_text("utf-8"))
    parser.close()
    return parser


@pytest.fixture(scope="module")
def facts(page) -> dict:
    return json.loads(page.scripts["facts"])


def block(page: Scripts, name: str) -> bytes:
    return base64.b64decode(page.scripts[name])


def test_the_policy_allows_the_code_and_style_of_the_page_alone(page):
    def digest(name: str) -> str:
        return f"'sha256-{base64.b64encode(hashlib.sha256(page.scripts[name].encode()).digest()).decode()}'"

    parts = dict(part.split(" ", 1) for part in page.policy.split("; "))
    assert parts["default-src"] == "'none'"
    assert parts["script-src"] == f"{digest('importmap')} {digest('module')} data:"
    assert parts["style-src"] == digest("style")
    assert page.loads == []


def test_modules_are_data_and_import_each_other_by_name(page):
    modules = json.loads(page.scripts["importmap"])["imports"]
    assert "three" in modules
    for name, url in modules.items():
        code = base64.b64decode(url.removeprefix("data:text/javascript;base64,")).decode()
        if name != "three":
            imported = re.findall(r'^import .* from "(.*)";$|import "(.*)"', code, re.MULTILINE)
            assert {first or second for first, second in imported} <= set(modules)
            assert "innerHTML" not in code
            assert "eval(" not in code


def test_names_stand_in_the_page_as_json_only(page, facts):
    assert {frame["scene"] for frame in facts["frames"]} >= {EVIL}
    assert facts["runs"] == list(RUNS)
    assert "<" not in page.scripts["facts"]


def test_labels_images_and_tables_are_those_of_the_frames(page, facts):
    for number, frame in enumerate(made_frames()):
        packed = facts["frames"][number]
        for grid, name in ((CYLINDER, "0"), (CUBOID, "1")):
            assert np.array_equal(
                np.frombuffer(gzip.decompress(block(page, packed["truth"][name])), np.uint8),
                frame.truth[grid].flatten().numpy(),
            )
        for place, run in enumerate(RUNS):
            labels = gzip.decompress(block(page, packed["predictions"][place]["labels"]))
            assert labels == frame.predictions[run].labels.numpy().tobytes()
        for image, shown in zip(frame.images, packed["images"], strict=True):
            decoded = cv2.imdecode(np.frombuffer(block(page, shown["block"]), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
            assert np.abs(decoded.astype(int) - image).mean() < 4
    assert [grid["kind"] for grid in facts["grids"]] == ["cylinder", "cuboid"]
    assert len(facts["rigs"]) == 1  # the same for all frames
    camera = facts["rigs"][0]["cameras"][2]
    table = direction_table(rig(), 2)
    assert gzip.decompress(block(page, camera["directions"])) == table.directions.tobytes()
    bits = np.unpackbits(np.frombuffer(gzip.decompress(block(page, camera["valid"])), np.uint8))
    assert np.array_equal(bits[: table.valid.size].astype(bool), table.valid.flatten())


def test_points_and_rays_of_cells_are_in_the_page(page, facts):
    for number, frame in enumerate(facts["frames"][:2]):
        counts = np.frombuffer(gzip.decompress(block(page, frame["evidence"]["0"])), np.uint8)
        assert counts.tolist() == evidence(number, CYLINDER).clamp(max=255).flatten().tolist()


def test_figures_that_do_not_count_are_left_out(facts):
    assert [frame["predictions"][0]["figures"] for frame in facts["frames"]][1] == {"rayiou": 0.31, "iou": 0.5}


def test_large_images_are_scaled(tmp_path):
    shown = made_shown(RUNS[:1])
    frame = next(made_frames(RUNS[:1]))
    big = tuple(cv2.resize(image, (2048, 1152)) for image in frame.images)
    write_page(shown, [replace(frame, images=big)], tmp_path / PAGE)
    parser = Scripts()
    parser.feed((tmp_path / PAGE).read_text())
    first = json.loads(parser.scripts["facts"])["frames"][0]["images"][0]
    decoded = cv2.imdecode(np.frombuffer(block(parser, first["block"]), np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == (576, 1024, 3)


def test_every_frame_has_the_road_of_its_rig():
    low, other = replace(rig(), road_z_m=-0.7), replace(next(made_frames(RUNS)), images=())
    for stated, expected in ((-2.2, (-0.7, -2.2)), (-1.5, (-0.7, -1.5)), (None, (-0.7, -2.2))):
        packed = Packed(replace(made_shown(), road_z_m=stated), 32)
        packed.add(replace(other, rig=low))
        packed.add(other)
        assert tuple(frame["road_z_m"] for frame in packed.facts["frames"]) == expected
    assert packed.facts["car"]["road_z_m"] == -2.2


def test_unknown_predictions_and_missing_truth_are_left_out(tmp_path):
    shown = made_shown(RUNS[:1])
    frame = replace(next(made_frames(RUNS[:1])), truth={}, images=(), rig=None, range_m=None)
    write_page(shown, [replace(frame, predictions={})], tmp_path / PAGE)
    parser = Scripts()
    parser.feed((tmp_path / PAGE).read_text())
    packed = json.loads(parser.scripts["facts"])["frames"][0]
    assert packed["predictions"] == [None]
    assert (packed["truth"], packed["images"], packed["rig"], packed["panoramas"]) == ({}, [], None, [])


def test_a_page_without_frames_is_refused(tmp_path):
    with pytest.raises(UserError, match="no frames to show"):
        write_page(made_shown(), [], tmp_path / PAGE)
    assert not list(tmp_path.iterdir())


def test_the_page_of_one_run_lies_in_its_folder(tmp_path):
    assert page_path(None, [str(tmp_path)]) == tmp_path / PAGE
    assert str(page_path("mine.html", [str(tmp_path)])) == "mine.html"
    assert str(page_path(None, ["tiny"])) == str(page_path(None, [str(tmp_path), str(tmp_path)])) == PAGE


def test_three_is_the_file_that_its_version_names():
    vendor = files("omniocc.extras.viewer.page").joinpath("vendor")
    words = vendor.joinpath("VERSION").read_text().split()
    assert words[::2] == ["three", "esbuild", "sha256"]
    assert hashlib.sha256(vendor.joinpath("three.min.js").read_bytes()).hexdigest() == words[5]
    assert "The MIT License" in vendor.joinpath("LICENSE").read_text()
    assert "SPDX-License-Identifier: MIT" in vendor.joinpath("three.min.js").read_text()[:400]


def test_labels_take_few_bytes(page, facts):
    grid_bytes = torch.Size(CYLINDER.shape).numel()
    packed = [len(page.scripts[frame["truth"]["0"]]) for frame in facts["frames"]]
    assert max(packed) < grid_bytes / 5
