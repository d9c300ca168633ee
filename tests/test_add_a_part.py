"""The refiner of docs/how_to/add_a_part.md: its test passes, its yaml makes a model, its table is what is printed."""

import re
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import pytest
import torch
from omegaconf import OmegaConf
from scripts import run_script

from omniocc.config import build, check_root, compose_plain
from omniocc.geometry import Cylinder

ROOT = Path(__file__).parents[1]
HOW_TO = ROOT / "docs" / "how_to"
TEXT = (HOW_TO / "add_a_part.md").read_text()
FILE = re.compile(r"`([\w/.]+)`[^\n`]*:\n\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILES = dict(FILE.findall(TEXT))
OF_PACKAGES = dict(FILE.findall((HOW_TO / "own_modules.md").read_text()))


def module(path: str, files: Mapping[str, str] = FILES) -> ModuleType:
    """Return the Python file of a page as a module."""
    made = ModuleType(path.removeprefix("src/").removesuffix(".py").replace("/", "."))
    exec(compile(files[path], path, "exec"), made.__dict__)
    return made


@pytest.fixture
def my_refiner(monkeypatch) -> type:
    """Return the class of the page, importable as if its file were there."""
    made = module("src/omniocc/model/refiner/my_refiner.py")
    monkeypatch.setitem(sys.modules, made.__name__, made)
    return made.MyRefiner


def test_the_test_of_the_page_passes_and_finds_a_seam(my_refiner, monkeypatch):
    tested = module("tests/model/refiner/test_my_refiner.py")
    tested.test_rotating_the_world_rotates_the_answer()
    without = sys.modules["omniocc.model.ops.padding"].pad3d
    monkeypatch.setitem(
        my_refiner.forward.__globals__, "pad3d", lambda volume, cells, _: without(volume, cells, (False,) * 3)
    )
    with pytest.raises(AssertionError, match="not close"):
        tested.test_rotating_the_world_rotates_the_answer()


def test_the_refiner_of_a_package_of_ones_own_has_no_seam_either():
    refiner = module("mylib/refiner.py", OF_PACKAGES).Plain(Cylinder((4, 8, 3)), 2, 5)
    volume = torch.randn(1, 2, 4, 8, 3)
    refined = refiner(volume, None)
    assert refined.shape == (1, 5, 4, 8, 3)
    torch.testing.assert_close(refiner(volume.roll(1, dims=3), None), refined.roll(1, dims=3))


def test_the_three_files_of_the_page_are_an_option_at_every_preset(my_refiner, tmp_path):
    code, option, test = FILES
    assert (Path(code).stem, Path(option).stem, Path(test).stem) == ("my_refiner", "my_refiner", "test_my_refiner")
    shutil.copytree(ROOT / "conf", tmp_path / "conf")
    (tmp_path / option).write_text(FILES[option])
    for preset in ("smoke", "tiny", "small", "paper"):
        words = [f"preset={preset}", "model/refiner=my_refiner", "model.backbone.weights=null"]
        cfg = OmegaConf.create(compose_plain(tmp_path / "conf", "train", words))
        check_root(cfg)
        refiner = build(cfg.model.refiner)
        assert isinstance(refiner, my_refiner)
        assert refiner.channels == cfg.preset.channels


@pytest.mark.whole_runs
@pytest.mark.slow(20)
def test_the_table_of_the_page_is_what_compare_prints(tmp_path):
    (arguments,) = re.findall(r"^`python src/report\.py (--runs .*?)` prints:$", TEXT, re.MULTILINE)
    (printed,) = re.findall(r"^```text\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    words = [str(ROOT / word) if word.startswith("docs/") else word for word in arguments.split()]
    result = run_script("report.py", *words, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (0, printed), result.stderr
