"""The metric and the platform are two packages: each wheel holds all of its own, and the metric needs no platform."""

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

pytestmark = [pytest.mark.slow(30), pytest.mark.whole_runs]

ROOT = Path(__file__).parents[1]
METRIC = ROOT / "src" / "rayiou"
LEFT_OUT = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
EXAMPLE = """
import numpy as np
import omniocc
from omniocc.camera import Rig

rig = Rig.load("fisheye6")
images = [np.zeros((camera.height, camera.width, 3), np.uint8) for camera in rig.cameras]
print(omniocc.load("tiny").predict(images, rig).labels.shape)
"""


def project(path: Path) -> dict:
    return tomllib.loads(path.read_text(encoding="utf-8"))["project"]


def wheel_of(source: Path, folder: Path) -> Path:
    """Return the wheel of a package, which is built from a copy, since building leaves files behind."""
    copy = folder / "source"
    if source == ROOT:
        for name in ("src", "conf", "sweeps"):
            shutil.copytree(ROOT / name, copy / name, ignore=LEFT_OUT, symlinks=True)
        for name in ("pyproject.toml", "README.md", "LICENSE"):
            shutil.copy(ROOT / name, copy)
    else:
        shutil.copytree(source, copy, ignore=LEFT_OUT)
    pip("wheel", "--no-deps", "--wheel-dir", folder / "wheels", copy)
    (wheel,) = (folder / "wheels").glob("*.whl")
    return wheel


def pip(*arguments: str | Path) -> None:
    subprocess.run([sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *arguments], check=True)


def run(code: str, folder: Path, *wheels: Path) -> str:
    """Return what code prints in an empty environment with these wheels.

    Their requirements, which take minutes to install, are those of this environment.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    pip("install", "--no-deps", "--target", folder / "installed", *wheels)
    path = os.pathsep.join([str(folder / "installed"), str(Path(torch.__file__).parents[1])])
    command = [folder / "venv" / "bin" / "python", "-c", code]
    done = subprocess.run(command, env={"PYTHONPATH": path}, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_metric_works_without_the_platform(tmp_path):
    wheel = wheel_of(METRIC, tmp_path)
    with zipfile.ZipFile(wheel) as content:
        modules = {name for name in content.namelist() if name.endswith(".py")}
    written = (path for path in METRIC.rglob("*.py") if "build" not in path.parts)
    assert modules == {f"rayiou/{path.relative_to(METRIC).as_posix()}" for path in written}
    (example,) = re.findall(r"```python\n(.*?)```", (METRIC / "README.md").read_text(), re.DOTALL)
    given = (
        "import torch; preds = torch.full((1, 200, 200, 16), 17); preds[..., :3] = 11; target = preds.clone()\n"
        "origins = torch.tensor([[[0.99, 0.0, 1.84]]])\n"
    )
    alone = "import importlib.util; assert not importlib.util.find_spec('omniocc')"
    assert run(f"{given}{example}\n{alone}", tmp_path, wheel) == "tensor(1.)\n"


@pytest.mark.slow(30)
def test_the_platform_predicts_from_its_wheel_with_weights_and_configuration(tmp_path):
    wheels = [wheel_of(source, tmp_path / source.name) for source in (ROOT, METRIC)]
    assert run(EXAMPLE, tmp_path, *wheels) == "(64, 100, 8)\n"


def test_both_packages_have_one_version():
    platform, metric = project(ROOT / "pyproject.toml"), project(METRIC / "pyproject.toml")
    assert platform["version"] == metric["version"]
    assert f"rayiou=={metric['version']}" in platform["dependencies"]
    needed = {re.split(r"[><=!~ ]", line)[0] for line in metric["dependencies"]}
    assert needed == {"torch", "torchmetrics", "numpy", "numba", "jaxtyping"}
