"""Multiruns on a real Slurm of one node (`make test-cluster`)."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from omniocc.progress import read_status
from omniocc.runs.results import METRICS

pytestmark = pytest.mark.cluster
ROOT = Path(__file__).parents[2]
SMALL = ("preset=smoke", "logger.mode=disabled", "test_images=0", "model/sketch=dense")


def command(data: Path, *arguments: str) -> list[str]:
    launcher = ("hydra/launcher=slurm", "hydra.launcher.cpus_per_task=1", f"paths.data={data}")
    return [sys.executable, str(ROOT / "src" / "train.py"), "--multirun", *SMALL, *launcher, *arguments]


def multirun(slurm: dict[str, str], folder: Path, data: Path, *arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        command(data, *arguments), env=slurm, cwd=folder, capture_output=True, text=True, check=False, timeout=400
    )


def states(slurm: dict[str, str], array: str) -> dict[str, str]:
    """Return what Slurm says of the jobs of an array."""
    listed = ["squeue", "--noheader", "--array", "--states=all", f"--jobs={array}", "--format=%i %T"]
    answer = subprocess.run(listed, env=slurm, capture_output=True, text=True, check=True)
    return dict(line.split() for line in answer.stdout.splitlines())


def until(found, within_s: float = 240.0):
    """Return what a function returns once that is true; fail if it never is."""
    deadline_s = time.monotonic() + within_s
    while time.monotonic() < deadline_s:
        if value := found():
            return value
        time.sleep(0.5)
    raise AssertionError(f"not within {within_s:g} s")


def test_two_rows_finish_and_one_that_cannot_is_shown_in_a_line(slurm, shared_data, tmp_path):
    shapes = "model.geometry.shape=[16,20,4],[8,20,4],[0,20,4]"
    result = multirun(slurm, tmp_path, shared_data, "stages.occupancy.max_steps=2", shapes)
    assert result.returncode == 1, result.stdout + result.stderr
    assert "2 of 3 jobs finished" in result.stdout
    said = [line for line in result.stdout.splitlines() if line.startswith("failed")]
    assert len(said) == 1
    assert "[0,20,4]" in said[0]
    assert len(result.stdout.splitlines()) < 15
    assert not result.stderr
    for path in tmp_path.glob(f"runs/train-*/{METRICS}"):
        assert json.loads(path.read_text())["command"].startswith("python /")
    array = result.stdout.split("number ")[1].split(" ")[0]
    # a job has written its results some moments before Slurm knows that it has ended
    until(lambda: not {"RUNNING", "COMPLETING"} & set(states(slurm, array).values()), within_s=60)
    assert sorted(states(slurm, array).values()) == ["COMPLETED", "COMPLETED", "FAILED"]


def test_a_job_that_is_told_to_stop_is_queued_again_and_loses_no_step(slurm, shared_data, tmp_path):
    steps = ["stages.occupancy.max_steps=400", "checkpoint_every_n_steps=1000", "trainer.limit_val_batches=1"]
    whole = multirun(slurm, tmp_path, shared_data, *steps, "name=whole")
    assert whole.returncode == 0, whole.stdout + whole.stderr
    arguments = command(shared_data, *steps, "name=stopped")
    with (tmp_path / "said").open("w") as said:
        process = subprocess.Popen(arguments, env=slurm, cwd=tmp_path, stdout=said, stderr=said)
    array = until(lambda: (tmp_path / "said").read_text().partition("number ")[2].partition(" ")[0])
    log = until(lambda: sorted(tmp_path.glob("runs/sweeps/*/*.log"))[1:])[0]  # the first is of the whole run
    until(
        lambda: (
            "train" in status.title and status.done if (status := read_status(log.with_suffix(".status.json"))) else 0
        )
    )
    subprocess.run(["scancel", "--signal=USR2", array], env=slurm, check=True)
    assert process.wait(300) == 0, (tmp_path / "said").read_text()
    text = log.read_text()
    assert text.count("stopped by SIGUSR2 at step") == 1
    assert "goes on from last.ckpt" in text
    figures = [json.loads(path.read_text())["metrics"] for path in sorted(tmp_path.glob(f"runs/*/{METRICS}"))]
    assert len(figures) == 2
    assert figures[0] == figures[1]


def test_at_its_time_limit_a_job_saves_and_is_queued_again(slurm, shared_data, tmp_path):
    limit = ["hydra.launcher.timeout_min=3", "hydra.launcher.signal_delay_s=60"]
    endless = ["stages.occupancy.max_steps=1000000", "checkpoint_every_n_steps=1000000", "trainer.limit_val_batches=1"]
    with (tmp_path / "said").open("w") as said:
        process = subprocess.Popen(
            command(shared_data, *limit, *endless), env=slurm, cwd=tmp_path, stdout=said, stderr=said
        )
    array = until(lambda: (tmp_path / "said").read_text().partition("number ")[2].partition(" ")[0])
    log = until(lambda: sorted(tmp_path.glob("runs/sweeps/*/*.log")))[0]
    until(lambda: "goes on from last.ckpt" in log.read_text(), within_s=500)
    subprocess.run(["scancel", array], env=slurm, check=True)
    assert process.wait(120) == 1, (tmp_path / "said").read_text()
    stopped = re.findall(r"stopped by SIGUSR2 at step (\d+)", log.read_text())
    assert stopped
    assert int(stopped[0]) > 0


def test_a_row_of_two_tasks_trains_one_model(slurm, shared_data, tmp_path):
    two = ["trainer.accelerator=cpu", "trainer.devices=2", "trainer.strategy=ddp", "hydra.launcher.tasks_per_node=2"]
    result = multirun(slurm, tmp_path, shared_data, *two, "stages.occupancy.max_steps=2", "data.batch_size=1")
    assert result.returncode == 0, result.stdout + result.stderr
    (path,) = tmp_path.glob(f"runs/train-*/{METRICS}")
    assert json.loads(path.read_text())["steps"] == 2
    (second,) = tmp_path.glob("runs/sweeps/*/*.task1.log")
    assert "Traceback" not in second.read_text()


def test_what_the_cluster_does_not_have_is_a_line(slurm, shared_data, tmp_path):
    for option, reason in (("gpus_per_node=1", "generic resource (gres)"), ("partition=gpu", "Invalid partition")):
        result = multirun(slurm, tmp_path, shared_data, f"hydra.launcher.{option}")
        assert result.returncode == 1
        assert result.stdout == ""
        assert len(result.stderr.splitlines()) == 1
        assert reason in result.stderr


def test_without_slurm_a_line_says_so(slurm, shared_data, tmp_path):
    without = slurm | {"PATH": str(Path(sys.executable).parent)}
    result = multirun(without, tmp_path, shared_data)
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr.splitlines() == [
        "hydra/launcher=slurm needs Slurm, whose sbatch is not here; hydra/launcher=process needs nothing"
    ]


def test_scenes_are_rendered_by_an_array(slurm, tmp_path):
    script = [sys.executable, str(ROOT / "src" / "render.py"), "--multirun", "preset=smoke", "hydra/launcher=slurm"]
    options = ["hydra.launcher.cpus_per_task=1", "scenes=1", "first_scene=0,1"]
    result = subprocess.run(
        [*script, *options], env=slurm, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert len(list(tmp_path.glob("data/virtual-*/*/meta.json"))) == 2
