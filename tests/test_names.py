"""One rule for all names that become parts of paths, wherever they come from: nothing is written by a wrong one."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import yaml

from omniocc.camera import Rig
from omniocc.config import ConfigError, check_root
from omniocc.data.formats.index import Index
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import META, SceneWriter, digest
from omniocc.errors import DataError, UserError
from omniocc.extras.recorders.log_scene import check_name
from omniocc.io import checked_name
from omniocc.report.runs import read_runs
from omniocc.runs.folder import open_run
from omniocc.runs.results import save_results
from omniocc.runs.robustness import UNDISTURBED, PartScores, Robustness, read_robustness, save_robustness
from omniocc.runs.script import train_config
from omniocc.runs.wandb import Loggers

ROOT = Path(__file__).parents[1]
WRONG = [
    "",
    " ",
    "..",
    ".hidden",
    "../x",
    "a/b",
    "stages/depth",
    "/tmp/x",
    r"a\b",
    " a",
    "a ",
    "a\nb",
    "a|b",
    "a\0b",
    "<img src=x>",
    "a:b",
    "a?b",
    'a"b',
    "x" * 101,
    "ä" * 51,
]
RIGHT = ["ours", "extended", "v1.2", "lr=0.01, b", "my run (2)", "Straße", "x" * 100, "CAM_FRONT", "a#b", "a$b"]


def content(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*"))


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_name_gives_one_line_with_the_value(name):
    with pytest.raises(UserError, match=r"^name is .*; files are called by it: 1 to 100 printable") as error:
        checked_name("name", name)
    assert len(str(error.value).splitlines()) == 1
    assert len(str(error.value)) < 300


@pytest.mark.parametrize("name", RIGHT)
def test_a_right_name_stays_as_it_is(name):
    assert checked_name("name", name) == name


def test_no_run_is_called_so(tmp_path):
    for name in ("", "../x"):
        with pytest.raises(UserError, match="name is"):
            open_run(tmp_path / "runs", name, "01234567", "auto")
        assert content(tmp_path) == []


@pytest.mark.parametrize("key", ["name", "preset.name", "logger.group"])
def test_train_names_the_key_before_anything_is_made(key):
    cfg = train_config(["preset=smoke", f"{key}='../x'"])
    with pytest.raises(ConfigError, match=rf"problems? in .*\n  {key} is '\.\./x'; files are called by it"):
        check_root(cfg)


@pytest.mark.parametrize("row", ["ours", "wo_temporal"])
def test_rows_have_right_names(row):
    cfg = train_config([f"+ablation={row}"])
    check_root(cfg)
    assert cfg.name == row


def test_groups_of_runs():
    assert Loggers("offline", "omniocc", None, ()).group is None
    with pytest.raises(UserError, match="group is 'a/b'"):
        Loggers("offline", "omniocc", "a/b", ())


@pytest.mark.parametrize("key", ["preset", "steps", "data"])
def test_records_of_runs_with_wrong_names_are_left_out_and_named(key, tmp_path, capsys):
    facts = {"preset": "tiny", "steps": 10, "data": "0123"}
    save_results(tmp_path / "good-01234567", {"test/rayiou": 0.1}, facts)
    save_results(tmp_path / "bad-01234567", {"test/rayiou": 0.2}, facts | {key: "../.."})
    assert [run.name for run in read_runs(tmp_path)] == ["good-01234567"]
    lines = capsys.readouterr().err.splitlines()
    (line,) = (line for line in lines if not line.startswith("reading runs"))
    assert line.startswith(f"left out: {tmp_path / 'bad-01234567' / 'metrics.json'}")
    assert f"{key} is '../..'" in line


def test_records_of_robustness_with_wrong_names_are_left_out_and_named(tmp_path, capsys):
    part = PartScores(UNDISTURBED, UNDISTURBED, ["a"], 1, 1.0, {"rayiou": 0.5}, without={"rayiou": []})
    save_robustness(tmp_path / "robustness-a", Robustness("../../x", {}, [part]))
    save_robustness(tmp_path / "robustness-b", Robustness("tiny", {}, [part._replace(part="a/b")]))
    save_robustness(tmp_path / "robustness-c", Robustness("tiny", {}, [part]))
    assert [record.parts[0].part for record in read_robustness(tmp_path)] == [UNDISTURBED]
    first, second = capsys.readouterr().err.splitlines()
    assert "system is '../../x'" in first
    assert "part is 'a/b'" in second


@pytest.mark.parametrize("name", ["", "../x", "a\0b"])
def test_no_camera_is_called_so(name, tmp_path):
    rig = Rig.load("fisheye6")
    with pytest.raises(ValueError, match="the name of a camera is"):
        replace(rig, names=(name, *rig.names[1:]))
    rig.save(tmp_path / "rig.yaml")
    entries = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    first, *others = entries["cameras"].items()
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"cameras": {name: first[1], **dict(others)}}))
    with pytest.raises(ValueError, match=r"rig\.yaml: the name of a camera is"):
        Rig.load(tmp_path / "rig.yaml")


def test_a_scene_whose_files_lead_elsewhere_is_damaged(tmp_path):
    writer = SceneWriter(tmp_path / "scene")
    writer.append({"a.bin": b"1"}, {"time_s": 0.0, "world_from_ego": np.eye(4).tolist()})
    writer.finish({})
    writer.close()
    assert SceneReader(tmp_path / "scene").meta["files"]
    meta = json.loads((tmp_path / "scene" / META).read_text())
    meta["files"]["rig.x/../../../out"] = {"size": 1, "sha256": "0"}
    claimed = digest({key: value for key, value in meta.items() if key != "digest"})
    (tmp_path / "scene" / META).write_text(json.dumps(meta | {"digest": claimed}))
    with pytest.raises(
        DataError, match=r"meta\.json: scene 'scene': the name of a file is 'rig\.x/\.\./\.\./\.\./out'"
    ):
        _ = SceneReader(tmp_path / "scene").meta


class Row(NamedTuple):
    tokens: np.ndarray


def test_no_index_of_a_dataset_is_written_for_a_scene_called_so(tmp_path):
    index = Index(tmp_path / "index", Row, lambda: {"../x": Row(np.zeros(1))})
    with pytest.raises(UserError, match=r"the name of a scene is '\.\./x'"):
        index.prepare()
    assert [path.suffix for path in content(tmp_path)] in ([], [".lock"])


def test_no_scene_is_recorded_under_such_a_name():
    for name in ("", "a/b", "a.b"):
        with pytest.raises(ValueError, match="name is"):
            check_name(name)


def test_weights_are_not_written_elsewhere():
    spec = importlib.util.spec_from_file_location("make_weights", ROOT / "tools" / "make_weights.py")
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    with pytest.raises(UserError, match=r"NAME is '\.\./weights/tiny'"):
        tool.recipe_of("../weights/tiny")
