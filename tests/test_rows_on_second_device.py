"""Every row of the tables trains and is tested on the simulated second device, all stages: `make test-device`."""

import json
from pathlib import Path

import pytest
from scripts import run_script

from omniocc.runs.rows import STEPS, TABLES, known_rows, table_files

CONF = Path(__file__).parents[1] / "conf"
ROWS = {
    row: words
    for row, words in known_rows(CONF, table_files(CONF / TABLES)).items()
    if not any(word.startswith(STEPS) for word in words)
    and any("." not in word.partition("=")[0] for word in words if word != f"name={row}")
}
"""Rows that choose an option, not only values."""
OPTIONS = ["preset=smoke", "data.num_workers=0", "logger.mode=disabled", "test_images=1"]


@pytest.mark.second_device
@pytest.mark.slow(20)
@pytest.mark.parametrize("row", ROWS)
def test_a_row_trains_and_is_tested_there(row, data_root, tmp_path):
    options = [*OPTIONS, *ROWS[row], f"paths.data={data_root}"]
    done = run_script("../tests/train_on_second_device.py", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = tmp_path.glob(f"runs/{row}-*/metrics.json")
    assert json.loads(path.read_text())["metrics"]["label/rayiou"] == 1.0
