"""Every row of the tables trains and is tested on the simulated second device, all stages: `make test-device`."""

import json
from pathlib import Path

import pytest
from scripts import run_script

FOLDER = Path(__file__).parents[1] / "conf" / "ablation"
FILES = [path.relative_to(FOLDER) for path in FOLDER.rglob("*.yaml")]
VALUES = ("tried", "learning_rates", "equal", "interval")
"""Folders of rows that change values only."""
ROWS = sorted(path.with_suffix("").as_posix() for path in FILES if path.parts[0] not in VALUES)
OPTIONS = ["preset=smoke", "data.num_workers=0", "logger.mode=disabled", "test_images=1"]


@pytest.mark.second_device
@pytest.mark.slow(20)
@pytest.mark.parametrize("row", ROWS)
def test_a_row_trains_and_is_tested_there(row, data_root, tmp_path):
    options = [*OPTIONS, f"+ablation={row}", f"paths.data={data_root}"]
    done = run_script("../tests/train_on_second_device.py", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = tmp_path.glob(f"runs/{Path(row).name}-*/metrics.json")
    assert json.loads(path.read_text())["metrics"]["label/rayiou"] == 1.0
