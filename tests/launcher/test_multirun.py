"""Multiruns as users start them; jobs on one machine in detail: `test_process.py`."""

import json
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from scripts import run_script

ROOT = Path(__file__).parents[2]
SMOKE = ("preset=smoke", "logger.mode=disabled", "test_images=0")


@pytest.mark.whole_runs
@pytest.mark.slow(30)
def test_a_job_of_two_processes_trains_one_model(tmp_path, data_root):
    overrides = [
        "model/sketch=dense",
        "stages.occupancy.max_steps=2",
        "data.batch_size=1",
        "seed=4",
        f"paths.data={data_root}",
    ]
    distributed = ["trainer.accelerator=cpu", "trainer.devices=2", "trainer.strategy=ddp"]
    result = run_script("train.py", "--multirun", *SMOKE, *overrides, *distributed, cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "1 of 1 jobs finished" in result.stdout
    (path,) = tmp_path.glob("runs/train-*/metrics.json")
    written = json.loads(path.read_text())
    assert written["steps"] == 2
    assert written["metrics"]["label/rayiou"] == 1.0
    # a child process that started the sweep again would have another folder
    (log,) = tmp_path.glob("runs/sweeps/*/000-*.log")
    assert "Traceback" not in log.read_text()


@pytest.mark.whole_runs
@pytest.mark.slow(40)
def test_all_stages_are_trained_by_two_processes(tmp_path, data_root):
    overrides = [f"paths.data={data_root}", "trainer.accelerator=cpu", "trainer.devices=2", "trainer.strategy=ddp"]
    epochs = ["preset.stages.sketch.max_steps=-1", "preset.stages.sketch.max_epochs=2"]
    arguments = ["--multirun", *SMOKE, "seed=5", "model=extended", *overrides, *epochs]
    result = run_script("train.py", *arguments, cwd=tmp_path)
    (log,) = tmp_path.glob("runs/sweeps/*/000-*.log")
    assert result.returncode == 0, result.stdout + result.stderr + log.read_text()
    assert "Traceback" not in log.read_text()
    (path,) = tmp_path.glob("runs/train-*/metrics.json")
    # six frames, one batch of two for each process
    assert json.loads(path.read_text())["stages"] == {"depth": 4, "sketch": 2, "occupancy": 6}
    for stage, frames in (("depth", "ranges/*"), ("sketch", "candidates-*/*"), ("sketch", "evidence/*")):
        assert len(list(tmp_path.glob(f"runs/stages/{stage}-*/{frames}.frames"))) == 5
    again = run_script("train.py", *arguments, cwd=tmp_path)
    assert again.returncode == 0
    assert log.read_text().count("depth, stage 1 of 3 begins") == 1


def test_slurm_jobs_request_four_gpus_with_a_process_each():
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        launcher = compose("train", ["hydra/launcher=slurm_4gpu"], return_hydra_config=True).hydra.launcher
    assert launcher._target_.endswith("SlurmLauncher")
    assert (launcher.nodes, launcher.gpus_per_node, launcher.tasks_per_node) == (1, 4, 4)
    assert launcher.cpus_per_task == 8
