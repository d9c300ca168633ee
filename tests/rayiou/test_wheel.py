"""The metric is a package of its own: its wheel holds all of it and needs nothing of the platform."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "rayiou"


def project(path: Path) -> dict:
    return tomllib.loads(path.read_text())["project"]


@pytest.mark.slow
def test_the_wheel_works_in_an_empty_environment(tmp_path):
    """Its requirements, which take minutes to install, are those of this environment; the platform is not there."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    wheels = tmp_path / "wheels"
    source = shutil.copytree(PACKAGE, tmp_path / "source", ignore=shutil.ignore_patterns("__pycache__", "build"))
    written = {f"rayiou/{path.relative_to(source).as_posix()}" for path in source.rglob("*.py")}
    subprocess.run([*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", wheels, source], check=True)
    (wheel,) = wheels.glob("rayiou-*.whl")
    with zipfile.ZipFile(wheel) as content:
        modules = {name for name in content.namelist() if name.endswith(".py")}
    assert modules == written
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"
    place = tmp_path / "installed"
    subprocess.run([*pip, "install", "--quiet", "--no-deps", "--target", place, wheel], check=True)
    (example,) = re.findall(r"```python\n(.*?)```", (PACKAGE / "README.md").read_text(), re.DOTALL)
    made = (
        "import torch; preds = torch.full((1, 200, 200, 16), 17); preds[..., :3] = 11; target = preds.clone()\n"
        "origins = torch.tensor([[[0.99, 0.0, 1.84]]])\n"
    )
    check = "import importlib.util; assert not importlib.util.find_spec('omniocc')"
    path = {"PYTHONPATH": os.pathsep.join([str(place), str(Path(torch.__file__).parents[1])])}
    done = subprocess.run([python, "-c", f"{made}{example}\n{check}"], env=path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "tensor(1.)\n"


def test_both_packages_have_one_version():
    platform, metric = project(ROOT / "pyproject.toml"), project(PACKAGE / "pyproject.toml")
    assert platform["version"] == metric["version"]
    assert f"rayiou=={metric['version']}" in platform["dependencies"]
    needed = {re.split(r"[><=!~ ]", line)[0] for line in metric["dependencies"]}
    assert needed == {"torch", "torchmetrics", "numpy", "numba", "jaxtyping"}
