"""What `--help` shows: options and keys with the comments of their files."""

import re
from pathlib import Path

import pytest
import yaml

from omniocc.config import CONF
from omniocc.runs.help import WIDTH, first_comment, help_text, key_lines

COMMANDS = sorted(path.stem for path in CONF.glob("*.yaml"))
WITHOUT_COMMENTS = ("hydra", "sweep")


def test_every_option_says_what_it_is():
    options = [path for path in CONF.glob("*/**/*.yaml") if path.relative_to(CONF).parts[0] not in WITHOUT_COMMENTS]
    assert len(options) > 80
    assert [str(path) for path in options if not first_comment(path)] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_key_of_a_command_is_listed_with_its_comment(command):
    text = help_text(command, [])
    lines = text.splitlines()
    for key in set(yaml.safe_load((CONF / f"{command}.yaml").read_text())) - {"defaults", "hydra", "paths"}:
        assert re.search(rf"^{key}=\S+\s+\w", text, re.MULTILINE), key
    written = (CONF / f"{command}.yaml").read_text().splitlines()
    assert [line for line in lines if len(line) > WIDTH and f"      {line}" not in written] == []


def test_chosen_options_have_a_star_and_a_comment():
    lines = help_text("train", ["model/sketch=random"]).splitlines()
    assert "  * random  One fixed random set of voxels." in lines
    assert "    mono    The same sketch as omni, on monocular depth." in lines
    assert "    wo_temporal        only the newest frame" in lines
    assert len(lines) < 180


def test_keys_of_the_chosen_recorder_are_listed():
    assert "recorder.poses=tf " in help_text("record", ["recorder=bag"])
    assert "recorder.poses=" not in help_text("record", [])


def test_own_packages_have_options_in_the_help(tmp_path, monkeypatch):
    (tmp_path / "mylib" / "conf" / "model" / "sketch").mkdir(parents=True)
    (tmp_path / "mylib" / "__init__.py").touch()
    (tmp_path / "mylib" / "conf" / "model" / "sketch" / "bottom.yaml").write_text("# The lowest cells.\nlow: 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("OMNIOCC_PACKAGES", "mylib")
    assert "    bottom  The lowest cells." in help_text("train", []).splitlines()


def test_comments_stand_behind_a_key_or_above_it(tmp_path: Path):
    text = "# of the file\n\na: 1  # first\n# second,\n# in two lines\nb: {c: '#'}\nd:\n  e: ${a}\n  _target_: x\n"
    (tmp_path / "own.yaml").write_text(text)
    lines = list(key_lines(tmp_path / "own.yaml", "own."))
    assert [line.split() for line in lines] == [
        ["own.a=1", "first"],
        ["own.b={c:", "'#'}", "second,", "in", "two", "lines"],
        ["own.d.e=${a}"],
    ]
