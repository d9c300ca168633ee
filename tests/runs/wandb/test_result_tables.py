from math import nan

from omniocc.runs.wandb.result_tables import result_tables


def test_tables_have_the_columns_that_were_measured():
    metrics = {"test/rayiou/Road": 0.5, "test/rayiou/Pole": nan, "test/rayiou": 0.3, "test/rayiou_8.5-17m": 0.2}
    tables = result_tables(metrics | {"test/depth/mae_0-8.5m": 1.5, "val/rayiou/Road": 1.0})
    by_class = tables["tables/by_class"]
    assert by_class.columns == ["class", "voxel RayIoU"]
    assert by_class.rows[0] == ["Road", 0.5]
    assert dict(map(tuple, by_class.rows))["Pole"] is None
    assert len(by_class.rows) == 2
    by_range = tables["tables/by_range"]
    assert by_range.columns == ["range", "voxel RayIoU", "depth: MAE, m"]
    assert by_range.rows == [["0-8.5m", None, 1.5], ["8.5-17m", 0.2, None]]


def test_a_run_that_was_not_tested_has_no_tables():
    assert result_tables({"train/loss": 1.0}) == {}


def test_a_robustness_test_has_a_line_for_every_disturbance():
    metrics = {"robustness/undisturbed/rayiou": 0.5, "robustness/view_90_deg/rayiou": 0.2}
    metrics |= {"robustness/view_90_deg/drop": 0.3, "robustness/view_90_deg/error": nan}
    table = result_tables(metrics)["tables/robustness"]
    assert table.columns == ["disturbance", "RayIoU", "drop", "standard error"]
    assert table.rows == [["undisturbed", 0.5, None, None], ["view_90_deg", 0.2, 0.3, None]]
