"""The plan of a training, before anything is rendered."""

import re

import pytest
from scripts import run_script


@pytest.mark.slow(5)
def test_every_stage_that_trains_has_its_steps_and_time(tmp_path):
    """With recorded ranges there is no depth network to train."""
    options = [
        "preset=smoke",
        "model=voxformer",
        "model/depth=truth",
        "data.source.rig=pinhole6",
        "plan=true",
        "logger.mode=disabled",
    ]
    done = run_script("train.py", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "depth     nothing to train\n" in done.stdout
    for stage in ("sketch", "occupancy"):
        assert re.search(rf"\n{stage:10}\d+ steps of .*\n {{10}}.* a step: ", done.stdout)
    assert list(tmp_path.iterdir()) == []
