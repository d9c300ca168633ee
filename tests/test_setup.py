"""Which Pythons are supported is said once, before anything is installed, and the pins cover what is asked for."""

import re
import runpy
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PINS = dict(re.findall(r"^([\w.-]+)==([^\s;]+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE))


@pytest.mark.parametrize("version", [(3, 10, 13), (3, 15, 0)])
def test_another_python_ends_in_one_line(version, monkeypatch):
    monkeypatch.setattr(sys, "version_info", version)
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / "tools" / "python_version.py"))
    line = str(ended.value.code)
    assert "\n" not in line
    for words in (".".join(map(str, version)), sys.executable, "3.11 to 3.14", "make setup PYTHON=python3.12"):
        assert words in line


@pytest.mark.parametrize("version", [(3, 11, 0), (3, 14, 9)])
def test_a_supported_python_says_nothing(version, monkeypatch):
    monkeypatch.setattr(sys, "version_info", version)
    runpy.run_path(str(ROOT / "tools" / "python_version.py"))


def test_the_pythons_in_words_are_those_that_are_allowed():
    named = [entry.rsplit(" ", 1)[1] for entry in PROJECT["classifiers"] if " :: Python :: 3." in entry]
    allowed = SpecifierSet(PROJECT["requires-python"])
    assert named == [f"3.{minor}" for minor in range(5, 30) if f"3.{minor}.0" in allowed]
    assert f"Python {named[0]} to {named[-1]}" in (ROOT / "README.md").read_text()


def test_everything_asked_for_is_pinned_to_a_version_that_is_allowed():
    asked = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["dev"]]
    for requirement in map(Requirement, asked):
        if requirement.name not in ("omniocc", "rayiou"):
            assert requirement.specifier.contains(PINS[canonicalize_name(requirement.name)], prereleases=True)
    assert PINS["torch"] == "2.13.0"
    assert "://" not in (ROOT / "constraints.txt").read_text()
