import json
import math

import pytest

from omniocc.errors import UserError
from omniocc.report.runs import read_runs
from omniocc.report.tables.budget import table_of_runs
from omniocc.runs.results import load_results, save_results, show_results
from omniocc.runs.table import as_markdown, by_origin, markdown, per_class, summary

METRICS = {
    "test/rayiou": 0.25,
    "prior/rayiou": 0.125,
    "label/rayiou": 1.0,
    "test/rayiou_17-25.6m": 0.1,
    "test/rayiou_0-8.5m": 0.4,
    "test/rayiou_8.5-17m": 0.2,
    "test/rayiou/Road": 0.75,
    "test/rayiou/Pedestrian": math.nan,
    "label/lidar/rayiou": 0.6,
}


def test_a_cell_stays_one_cell_and_one_line():
    assert markdown(["row", "x"], [["a|b\n| c", "1"]]) == "| row | x |\n| --- | ---: |\n| a\\|b \\| c | 1 |\n"


def test_bands_stand_in_order_of_distance():
    head, rows = summary(METRICS)
    assert head == ["voxels", "voxel RayIoU", "0-8.5 m", "8.5-17 m", "17-25.6 m", "surface RayIoU", "IoU", "mIoU"]
    assert rows[0] == ["model", "0.250", "0.400", "0.200", "0.100", "–", "–", "–"]
    assert rows[2][:2] == ["upper bound (true voxels)", "1.000"]
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
    assert as_markdown(METRICS, "seed 3").startswith("seed 3\n\n| voxels | voxel RayIoU |")


PROTOCOL = {"voxel": "cells", "rayiou": "rays from here", "lidar/rayiou": "LiDAR rays"}


def test_the_tables_say_how_scores_were_counted(tmp_path, capsys):
    save_results(tmp_path, METRICS, {"seed": 3, "protocol": PROTOCOL})
    lines = ["Voxel RayIoU: rays from here.", "Surface RayIoU: LiDAR rays.", "IoU, mIoU: cells."]
    text = (tmp_path / "table.md").read_text()
    assert text.startswith("seed 3\n")
    assert text.endswith("\n\n".join(lines) + "\n")
    assert load_results(tmp_path)[0]["protocol"] == PROTOCOL
    show_results(tmp_path)
    printed = capsys.readouterr().out
    assert "\n".join(lines) in printed
    head, first = printed.split("\n\n")[0].strip("\n").splitlines()[:2]
    assert len(head) == len(first), "the head stands above its columns"
    assert as_markdown(METRICS, "") == as_markdown(METRICS, "", {})


def test_the_tables_say_how_many_lidar_rays_do_not_count():
    parts = {"": 0.54, "_unknown": 0.1, "_free": 0.44}
    found = as_markdown(METRICS | {f"test/lidar/left_out{end}": value for end, value in parts.items()}, "", PROTOCOL)
    assert found.endswith("IoU, mIoU: cells.\n\nLiDAR rays that do not count: 54.0 % (10.0 % unknown, 44.0 % free).\n")
    assert "do not count" not in as_markdown(METRICS | {"test/lidar/left_out": math.nan}, "", PROTOCOL)


def test_scores_by_origin_have_a_table():
    metrics = METRICS | {"test/rayiou_past": 0.2, "test/rayiou_now": 0.3, "test/rayiou_future": math.nan}
    metrics |= {"prior/rayiou_past": 0.1, "prior/rayiou_now": 0.15, "prior/rayiou_future": 0.05}
    assert summary(metrics) == summary(METRICS), "times are no distance bands"
    assert by_origin(metrics) == (
        ["RayIoU from", "model", "baseline (no image)", "upper bound (true voxels)"],
        [
            ["past frames", "0.200", "0.100", "–"],
            ["the frame itself", "0.300", "0.150", "–"],
            ["future frames", "–", "0.050", "–"],
            ["all", "0.250", "0.125", "1.000"],
        ],
    )
    assert "| past frames | 0.200 |" in as_markdown(metrics, "")
    assert "past frames" not in as_markdown(METRICS, "")


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
