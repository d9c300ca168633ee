"""All stages train on scenes that another run has rendered."""

import json

import pytest
from scripts import run_script

from omniocc.config import build


@pytest.mark.whole_runs
@pytest.mark.slow
def test_all_stages_train_on_recorded_scenes(smoke, data_root, tmp_path):
    rendered = build(smoke(f"paths.data={data_root}").data).source
    rendered.prepare()
    options = ["preset=smoke", "data=recorded", "trainer.accelerator=cpu", "logger.mode=disabled"]
    folders = [f"data.source.root={rendered.place}", f"data.source.cache={tmp_path / 'cache'}"]
    done = run_script("train.py", *options, *folders, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "rendering" not in done.stdout
    (path,) = tmp_path.glob("runs/train-*/metrics.json")
    metrics = json.loads(path.read_text())["metrics"]
    assert {"test/rayiou", "test/rayiou/Road", "test/lidar/rayiou", "test/depth/mae", "test/sketch/recall"} <= set(
        metrics
    )
    assert metrics["label/voxel/iou"] == 1.0
    assert len(list((tmp_path / "cache").glob("recorded-*/voxels-*/train-*"))) == 3
