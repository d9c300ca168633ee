"""A package outside the repository adds options by a class and a yaml each: that of docs/how_to/own_modules.md."""

import re
from pathlib import Path

import pytest
from scripts import run_script

from omniocc.code import spec_of

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "how_to" / "own_modules.md"
FILE = re.compile(r"^`([\w/.]+)`:\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^python src/train\.py (.*)$", re.MULTILINE)
SMALL = [
    "preset=smoke",
    "logger.mode=disabled",
    "test_images=0",
    "stages.occupancy.max_steps=2",
    "stages.depth.max_steps=2",
]
pytestmark = [pytest.mark.slow, pytest.mark.whole_runs]


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Write the files of the page; return the folder that holds the package."""
    folder = tmp_path_factory.mktemp("outside")
    files = dict(FILE.findall(PAGE.read_text()))
    assert len(files) == 15
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return folder


def run(script, *arguments, package, cwd, allowed="mylib"):
    return run_script(script, *arguments, cwd=cwd, PYTHONPATH=str(package), OMNIOCC_PACKAGES=allowed)


def test_the_commands_of_the_page_train_every_part_and_a_source(package, data_root, tmp_path):
    listed = COMMAND.findall(PAGE.read_text())
    assert len(listed) == 7
    for number, arguments in enumerate(listed):
        arguments = arguments.replace("/home/me", str(package)).split()
        own_depth = any(word.startswith(("model/sketch=", "model/depth=")) for word in arguments)
        more = [] if own_depth else ["model/sketch=dense"]  # depth needs no second training
        allowed = "" if any(word.startswith("packages=") for word in arguments) else "mylib"
        paths = [f"paths.data={data_root}", f"name=run{number}"]
        result = run("train.py", *arguments, *more, *SMALL, *paths, package=package, cwd=tmp_path, allowed=allowed)
        assert result.returncode == 0, result.stdout + result.stderr
        (results,) = tmp_path.glob(f"runs/run{number}-*/metrics.json")
        assert ("test/precision" in results.read_text()) == ("+callbacks=precision" in arguments)
    assert len(list(tmp_path.glob("runs/stages/depth-*/metrics.json"))) == 1

    (checkpoint,) = tmp_path.glob("runs/run0-*/last.ckpt")
    refused = run("evaluate.py", str(checkpoint), "--images=0", package=package, cwd=tmp_path, allowed="")
    assert refused.returncode == 1
    (line,) = refused.stderr.strip().splitlines()
    assert "last.ckpt names classes of mylib" in line
    assert "OMNIOCC_PACKAGES=mylib" in line
    for word, allowed in (("packages=[mylib]", ""), ("data.num_workers=0", "mylib")):
        loaded = run("evaluate.py", str(checkpoint), word, "--images=0", package=package, cwd=tmp_path, allowed=allowed)
        assert loaded.returncode == 0, loaded.stdout + loaded.stderr


def test_a_package_that_is_not_there_and_an_option_of_a_name_in_use_are_one_line(package, tmp_path):
    taken = tmp_path / "other" / "conf" / "model" / "sketch" / "random.yaml"
    taken.parent.mkdir(parents=True)
    taken.touch()
    (tmp_path / "other" / "__init__.py").touch()
    for allowed, words in (("mylbi", "mylbi, which OMNIOCC_PACKAGES names, cannot be imported"), ("other", str(taken))):
        result = run("train.py", "preset=smoke", package=tmp_path, cwd=tmp_path, allowed=allowed)
        assert result.returncode == 1
        assert [words in line for line in result.stderr.splitlines()] == [True]
    result = run("train.py", "preset=smoke", "packages=[mylbi]", package=package, cwd=tmp_path, allowed="")
    assert "packages: mylbi cannot be imported" in result.stderr
    assert spec_of("mylbi.part") is None


def test_a_class_of_a_package_that_is_not_allowed_is_one_problem(package, tmp_path):
    search = f"hydra.searchpath=[file://{package}/mylib/conf]"
    result = run("train.py", "preset=smoke", search, "model/sketch=bottom", package=package, cwd=tmp_path, allowed="")
    assert result.returncode == 1
    assert "model.sketch._target_: mylib.sketch.Bottom is of the package mylib" in result.stderr
    assert "packages=[mylib]" in result.stderr
    assert "Traceback" not in result.stderr
