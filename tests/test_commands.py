"""The commands that people use, word for word; only the environment makes them small."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import create_automatic_config_search_path
from hydra.core.override_parser.overrides_parser import OverridesParser
from scripts import run_script

ROOT = Path(__file__).parents[1]
ROWS = sorted(path.stem for path in (ROOT / "conf" / "ablation").glob("*.yaml"))
TRAIN = [
    "python src/train.py",
    "python src/train.py model/sketch=mono",
    "python src/train.py model/geometry=cuboid model/refiner=none",
]
SWEEP = "python src/train.py --multirun +ablation='glob(*)' seed=0,1,2"
MAKE = {
    "make demo": ".venv/bin/python tools/demo.py tiny",
    "make test": "OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n auto --dist worksteal"
    " -m 'not whole_runs and not second_device and not faults and not cluster and not browser and not hostile'",
    "make ablations": ".venv/bin/python src/train.py --multirun"
    " +sweep=comparison,semantic_temporal,refine,sketch,representation seed=0 preset=tiny",
    "make dashboard-local": ".venv/bin/python -m omniocc.report.wandb.local --runs runs",
    "make dashboard": ".venv/bin/python -m omniocc.report.wandb.dashboard --runs runs",
    "make wandb-sync": ".venv/bin/python -m omniocc.report.wandb.upload --runs runs",
}


@pytest.fixture
def checkout(tmp_path, data_root):
    """Return a folder that looks like a fresh checkout that has been set up, with rendered scenes in it."""
    for name in ("src", "conf", "tools", "Makefile", "pyproject.toml", "constraints.txt"):
        (tmp_path / name).symlink_to(ROOT / name)
    data_root.mkdir(exist_ok=True)
    (tmp_path / "data").symlink_to(data_root)
    (tmp_path / ".venv").mkdir()
    for name in (".used", ".ready"):
        (tmp_path / ".venv" / name).touch()
    return tmp_path


def shell(line: str, folder: Path, **more: str) -> subprocess.CompletedProcess:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT / "src"), **more}
    return subprocess.run(
        ["bash", "-c", line], cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=400
    )


@pytest.mark.whole_runs
@pytest.mark.slow(40)
def test_training_commands_run_as_they_stand(checkout):
    """The first is started by a shell, the others with the words that a shell would make of them, without imports."""
    for number, line in enumerate(TRAIN, start=1):
        if number == 1:
            result = shell(line, checkout, OMNIOCC_PRESET="smoke")
        else:
            python, script, *words = shlex.split(line)
            assert (python, script) == ("python", "src/train.py")
            result = run_script("train.py", *words, cwd=checkout, OMNIOCC_PRESET="smoke")
        assert result.returncode == 0, f"{line}\n{result.stdout}{result.stderr}"
        assert len(list(checkout.glob("runs/train-*/metrics.json"))) == number
        assert "RayIoU" in result.stdout
        assert "GPU available" not in result.stdout + result.stderr  # what Lightning tells


def jobs_of(line: str) -> list[tuple[str, ...]]:
    """Return the overrides of every job of a multirun, as Hydra's sweeper makes them."""
    arguments = shlex.split(line)[2:]
    assert arguments.pop(0) == "--multirun"
    loader = ConfigLoaderImpl(create_automatic_config_search_path(None, None, str(ROOT / "conf")))
    overrides = OverridesParser.create(config_loader=loader).parse_overrides(arguments)
    (batch,) = BasicSweeper.split_arguments(overrides, max_batch_size=None)
    return [tuple(job) for job in batch]


def test_the_sweep_has_a_job_for_every_row_and_seed(composed):
    jobs = jobs_of(SWEEP)
    assert sorted(jobs) == sorted((f"+ablation={row}", f"seed={seed}") for row in ROWS for seed in range(3))
    cfg = composed("+ablation=mono", "seed=2")
    assert (cfg.name, cfg.seed) == ("mono", 2)


@pytest.mark.parametrize(("line", "called"), MAKE.items())
def test_make_calls_the_same_commands(line, called, checkout):
    result = shell(line.replace("make", "make -n --no-print-directory", 1), checkout)
    assert result.returncode == 0, result.stderr
    first = result.stdout.splitlines()[0].removeprefix("@").strip()
    assert first.split(" \\")[0].strip() == called


def test_the_default_preset_of_a_machine_yields_to_the_command_line(checkout):
    for words, preset in (((), "smoke"), (("preset=small",), "small")):
        shown = ("--cfg", "job", "--package", "preset")
        result = run_script("train.py", *shown, *words, cwd=checkout, OMNIOCC_PRESET="smoke")
        assert f"name: {preset}" in result.stdout
