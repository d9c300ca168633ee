import csv

import numpy as np
import pytest
from offline_file import files_of, history, runs_in

from omniocc.runs.robustness import UNDISTURBED, PartScores, Robustness
from omniocc.runs.wandb import Loggers
from omniocc.runs.wandb.loggers import log_robustness, robustness_metrics


def part(name, group, score):
    return PartScores(
        name, group, ["a", "b"], 2, 1.0, {"rayiou": score}, without={"rayiou": [score - 0.1, score + 0.1]}
    )


RECORD = Robustness("tiny", {}, [part(UNDISTURBED, UNDISTURBED, 0.5), part("night", "night", 0.2)])
METRICS = {
    "robustness/undisturbed/rayiou": 0.5,
    "robustness/night/rayiou": 0.2,
    "robustness/night/drop": 0.3,
    "robustness/night/error": 0.0,
}


def test_scores_and_drops_are_logged_by_part():
    assert robustness_metrics(RECORD) == pytest.approx(METRICS)


def test_they_are_in_the_csv_file_and_with_plot_and_table_in_w_and_b_but_once(tmp_path):
    config = {"name": "tiny", "seed": 0, "stage": None, "model": {"sketch": {"_target_": "omniocc.model.sketch.Dense"}}}
    folder, plot = tmp_path / "robustness-tiny", np.zeros((8, 8, 3), np.uint8)
    for _ in range(2):  # the same command again
        log_robustness(Loggers("offline", "omniocc", None, []).build(folder, config, "robustness"), RECORD, plot)
    with next(folder.glob("csv/version_0/metrics.csv")).open() as file:
        (row,) = csv.DictReader(file)
    assert {key: float(row[key]) for key in METRICS} == pytest.approx(METRICS)
    first, second = files_of(folder)
    assert runs_in(first)[0].job_type == "robustness"
    rows = {key: value for row in history(first) for key, value in row.items()}
    assert {key: rows[key] for key in METRICS} == pytest.approx(METRICS)
    assert "robustness/plot" in rows
    assert rows["tables/robustness"]["nrows"] == 2
    again = {key for row in history(second) for key in row}
    assert not again & {*METRICS, "robustness/plot"}
