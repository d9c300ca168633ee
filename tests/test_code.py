"""Hashes of code: what counts and what does not; arguments that docstrings list."""

import ast
import re
import sys
from pathlib import Path

import pytest
from hydra.utils import get_class
from omegaconf import OmegaConf

from omniocc.code import code_fingerprint, code_of_classes, module_of


def test_code_fingerprint_ignores_comments_and_docstrings(tmp_path):
    prints = []
    for number, (says, comment, value) in enumerate([("A", "", 1), ("B", "  # why", 1), ("A", "", 2)]):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "a.py").write_text(f'"""{says}."""\ndef f():\n    """{says}."""\n    return {value}{comment}\n')
        prints.append(code_fingerprint(folder))
    assert prints[0] == prints[1] != prints[2]


def test_code_fingerprint_is_the_same_in_every_version_of_python(tmp_path):
    (tmp_path / "a.py").write_text(
        "class A:\n    def f(self, *x, y=None):\n        return [], f'{x!r:>{y}} {y}', lambda: self\n"
    )
    assert code_fingerprint(tmp_path) == "6102c8b8ccd2d57d"


def test_code_fingerprint_covers_subfolders_and_paths_of_modules(tmp_path):
    def fingerprint(**files: str) -> str:
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        for name, text in files.items():
            path = folder / f"{name.replace('_in_', '/')}.py"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        cache = folder / "town" / "__pycache__" / "left_over.py"
        cache.parent.mkdir(parents=True)
        cache.write_text(f"number = {len(list(tmp_path.iterdir()))}\n")
        return code_fingerprint(folder)

    one = fingerprint(a="x = 1\n", town_in_b="y = 1\n")
    assert one == fingerprint(a="x = 1\n", town_in_b="y = 1  # why\n")
    assert one != fingerprint(a="x = 1\n", town_in_b="y = 2\n")
    assert one != fingerprint(a="x = 1\n", traffic_in_b="y = 1\n")


FILES = {
    "__init__": "",
    "lifter": "from ownlib.ops import blend\nimport torch\nfrom . import tools\n\n\nclass Nearest:\n    pass\n",
    "ops": "def blend():\n    return 1\n",
    "tools": "import ownlib.deep.er\n",
    "deep/__init__": "",
    "deep/er": "number = 1\n",
    "sketch": "class Bottom:\n    pass\n",
}


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Write the package `ownlib`; return a function that changes a file and gives the hashes of its two classes."""
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [name for name in sys.modules if name.split(".")[0] == "ownlib"]:
        monkeypatch.delitem(sys.modules, name)

    def hashes(**changed: str) -> tuple[str, str]:
        for name, text in (FILES | {name.replace("_in_", "/"): text for name, text in changed.items()}).items():
            path = tmp_path / "ownlib" / f"{name}.py"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return code_of_classes(["ownlib.lifter.Nearest"]), code_of_classes(["ownlib.sketch.Bottom"])

    return hashes


def test_code_that_a_class_imports_counts_and_other_code_of_its_package_does_not(own):
    lifter, sketch = own()
    assert lifter != sketch
    assert own(lifter=FILES["lifter"] + "# why\n") == (lifter, sketch)
    for changed in ({"ops": "def blend():\n    return 2\n"}, {"deep_in_er": "number = 2\n"}, {"tools": "x = 1\n"}):
        other, same = own(**changed)
        assert other != lifter
        assert same == sketch
    assert own(sketch="class Bottom:\n    depth = 2\n")[0] == lifter


def test_installed_packages_do_not_count():
    assert code_of_classes(["torch.nn.Linear", "lightning.pytorch.Trainer", "no_such_package.Thing"]) == ""
    assert code_of_classes([]) == ""


def test_a_hash_does_not_depend_on_the_order_of_classes():
    names = ["omniocc.geometry.Cuboid", "omniocc.batch.Batch"]
    assert code_of_classes(names) == code_of_classes(names[::-1]) != code_of_classes(names[:1])
    assert Path(sys.modules["omniocc.geometry"].__file__).exists()


def arguments(definition: ast.FunctionDef | ast.ClassDef) -> set[str]:
    """Return the names of a function's arguments, of a class's `__init__`, or of its fields."""
    if isinstance(definition, ast.ClassDef):
        methods = [part for part in definition.body if isinstance(part, ast.FunctionDef) and part.name == "__init__"]
        if not methods:
            return {part.target.id for part in definition.body if isinstance(part, ast.AnnAssign)}
        definition = methods[0]
    given = definition.args
    return {part.arg for part in [*given.args, *given.kwonlyargs, given.vararg, given.kwarg] if part is not None}


def test_the_arguments_that_a_docstring_lists_exist():
    listed, wrong = 0, []
    for path in (Path(__file__).parents[1] / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            text = isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node)
            if not text or "Args:\n" not in text:
                continue
            names = re.findall(r"^    (\w+): ", re.split(r"\n\S|\n\n", text.split("Args:\n")[1])[0], re.MULTILINE)
            listed += len(names)
            wrong += [(path.name, node.name, name) for name in names if name not in arguments(node)]
    assert listed > 500
    assert wrong == []


def test_the_module_of_a_class_is_found_without_running_it():
    for path in sorted((Path(__file__).parents[1] / "conf" / "model").glob("*/*.yaml")):
        name = OmegaConf.load(path).get("_target_")
        if name is not None:
            assert module_of(name) == get_class(name).__module__, path
    assert module_of("omniocc.model.sketch.Nothing") == "omniocc.model.sketch"
    assert module_of("missing_package.module.Class") == "missing_package.module"
