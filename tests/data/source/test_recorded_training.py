"""All stages train on scenes that another run has rendered."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from omniocc.config import build

ROOT = Path(__file__).parents[3]


@pytest.mark.slow
def test_all_stages_train_on_recorded_scenes(smoke, data_root, tmp_path):
    rendered = build(smoke(f"paths.data={data_root}").data).source
    rendered.prepare()
    command = [
        sys.executable,
        str(ROOT / "src" / "train.py"),
        "preset=smoke",
        "data=recorded",
        "trainer.accelerator=cpu",
    ]
    command += [f"data.source.root={rendered.place}", f"data.source.cache={tmp_path / 'cache'}", "logger.mode=disabled"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=500)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "rendering" not in done.stdout
    (path,) = tmp_path.glob("runs/train-*/metrics.json")
    metrics = json.loads(path.read_text())["metrics"]
    assert {"test/rayiou", "test/rayiou/Road", "test/lidar/rayiou", "test/depth/mae", "test/sketch/recall"} <= set(
        metrics
    )
    assert metrics["label/voxel/iou"] == 1.0
    assert len(list((tmp_path / "cache").glob("recorded-*/voxels-*/train-*"))) == 3
