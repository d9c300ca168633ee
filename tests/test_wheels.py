"""The metric and the platform are two packages: each wheel holds all of its own, and the metric needs no platform."""

import json
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

import omniocc

pytestmark = [pytest.mark.slow(30), pytest.mark.whole_runs]

ROOT = Path(__file__).parents[1]
METRIC = ROOT / "src" / "rayiou"
LEFT_OUT = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
EXAMPLE = """
from pathlib import Path
import numpy as np
import omniocc
from PIL import Image
from omniocc.camera import Rig

rig = Rig.load("fisheye6")
images = [np.zeros((camera.height, camera.width, 3), np.uint8) for camera in rig.cameras]
Path("frame").mkdir()
for name, image in zip(rig.names, images):
    Image.fromarray(image).save(f"frame/{name}.png")
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


def environment(folder: Path, *wheels: Path) -> Path:
    """Return the folder of the programs of an empty environment with these wheels.

    Their requirements, which take minutes to install, are those of this environment.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    programs = folder / "venv" / "bin"
    pip("--python", programs / "python", "install", "--no-deps", *wheels)
    (packages,) = (folder / "venv" / "lib").glob("python*/site-packages")
    (packages / "requirements.pth").write_text(f"{Path(torch.__file__).parents[1]}\n")  # without its editable packages
    return programs


def run(folder: Path, *command: str | Path) -> str:
    """Return what a command prints in a folder outside of the repository."""
    folder.mkdir(exist_ok=True)
    variables = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "OMNIOCC_PRESET")}
    done = subprocess.run(command, env=variables, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
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
    python = environment(tmp_path, wheel) / "python"
    assert run(tmp_path / "here", python, "-c", f"{given}{example}\n{alone}") == "tensor(1.)\n"


@pytest.mark.slow(200)
def test_the_commands_work_from_wheels_outside_of_the_repository(tmp_path):
    wheels = [wheel_of(source, tmp_path / source.name) for source in (ROOT, METRIC)]
    programs, here = environment(tmp_path, *wheels), tmp_path / "here"
    command = programs / "omniocc"
    assert run(here, programs / "python", "-c", EXAMPLE) == "(64, 100, 8)\n"
    listed = re.findall(r"^  ([a-z]+) +[A-Z]", run(here, command, "--help"), re.MULTILINE)
    assert listed == sorted(path.stem for path in (ROOT / "src").glob("*.py"))
    assert "* virtual " in run(here, command, "train", "--help")
    run(here, command, "predict", "depth", "checkpoint=any-rig", "rig=fisheye6", "images=frame")
    assert (here / "prediction" / "range.npz").is_file()
    assert "RayIoU" in run(here, command, "train", "preset=smoke")
    (metrics,) = here.glob("runs/train-*/metrics.json")
    facts = json.loads(metrics.read_text())
    assert (facts["command"], facts["commit"]) == ("omniocc train preset=smoke", "unknown")
    assert "1 of 1 jobs finished" in run(here, command, "train", "--multirun", "preset=smoke")
    assert "train" in run(here, command, "report")
    assert sorted(path.name for path in here.iterdir()) == ["data", "frame", "prediction", "runs"]


def test_both_packages_have_one_version():
    platform, metric = project(ROOT / "pyproject.toml"), project(METRIC / "pyproject.toml")
    assert platform["version"] == metric["version"] == omniocc.__version__
    assert f"\nversion: {platform['version']}\n" in (ROOT / "CITATION.cff").read_text()
    assert platform["urls"] == metric["urls"]
    assert f"rayiou=={metric['version']}" in platform["dependencies"]
    needed = {re.split(r"[><=!~ ]", line)[0] for line in metric["dependencies"]}
    assert needed == {"torch", "torchmetrics", "numpy", "numba", "jaxtyping"}
