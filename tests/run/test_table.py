import json
import math

import pytest

from omniocc.errors import UserError
from omniocc.report.runs import read_runs
from omniocc.report.tables.overview import table_of_runs
from omniocc.run.results import load_results, save_results
from omniocc.run.table import as_markdown, per_class, summary

METRICS = {
    "test/rayiou": 0.25, "prior/rayiou": 0.125, "label/rayiou": 1.0,
    "test/rayiou_17-25.6m": 0.1, "test/rayiou_0-8.5m": 0.4,
    "test/rayiou_8.5-17m": 0.2, "test/rayiou/Road": 0.75, "test/rayiou/Pedestrian": math.nan, "label/lidar/rayiou": 0.6,
}  # fmt: skip


def test_bands_stand_in_order_of_distance():
    head, rows = summary(METRICS)
    assert head == ["", "RayIoU", "0-8.5 m", "8.5-17 m", "17-25.6 m", "RayIoU, LiDAR", "IoU", "mIoU"]
    assert rows[0] == ["model", "0.250", "0.400", "0.200", "0.100", "–", "–", "–"]
    assert rows[2][:2] == ["label (upper bound)", "1.000"]
    assert rows[2][5] == "0.600"


def test_classes_without_cases_show_a_dash():
    head, rows = per_class(METRICS)
    assert [row[0] for row in rows] == ["Road", "Pedestrian"]
    assert dict(zip(head, rows[0], strict=True))["model"] == "0.750"
    assert rows[1][1] == "–"


def test_results_survive_the_file(tmp_path):
    save_results(tmp_path, METRICS, {"seed": 3, "stages": {"depth": 8}, "classes": []})
    raw = json.loads((tmp_path / "metrics.json").read_text(), parse_constant=lambda name: f"not JSON: {name}")
    assert raw["seed"] == 3
    assert raw["metrics"]["test/rayiou/Pedestrian"] is None
    facts, loaded = load_results(tmp_path)
    assert facts == {"seed": 3, "stages": {"depth": 8}, "classes": []}
    assert (tmp_path / "table.md").read_text().startswith("seed 3\n"), "lists and mappings are no caption"
    assert math.isnan(loaded.pop("test/rayiou/Pedestrian"))
    assert loaded == {key: value for key, value in METRICS.items() if key != "test/rayiou/Pedestrian"}
    assert as_markdown(METRICS, "seed 3").startswith("seed 3\n\n|  | RayIoU |")


def test_runs_stand_side_by_side_best_first(tmp_path):
    for name, value in (("low", 0.1), ("high", 0.3)):
        (tmp_path / name).mkdir()
        save_results(tmp_path / name, {**METRICS, "test/rayiou": value}, {"seed": 3, "steps": 7})
    (tmp_path / "unfinished").mkdir()
    head, rows = table_of_runs(read_runs(tmp_path))
    assert [row[0] for row in rows] == ["high", "low"]
    assert rows[0][head.index("8.5-17m")] == "0.200"


def test_no_runs_is_an_error_that_says_what_to_do(tmp_path):
    with pytest.raises(UserError, match=r"train\.py"):
        read_runs(tmp_path)
