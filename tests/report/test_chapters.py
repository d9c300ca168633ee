"""Baseline and upper bound of every grid."""

from omniocc.report.chapters import bounds_cells
from omniocc.report.runs import FinishedRun

METRICS = {"prior/rayiou": 0.06, "prior/lidar/rayiou": 0.07, "label/rayiou": 1.0, "label/lidar/rayiou": 0.41}


def run(geometry):
    config = {"model": {"geometry": geometry}} if geometry else {}
    return FinishedRun("row-00000000", {}, METRICS, config=config)


def test_every_grid_has_one_line():
    cylinder = run({"_target_": "omniocc.geometry.Cylinder", "shape": [64, 100, 8]})
    head, lines = bounds_cells({"ours": [cylinder, cylinder], "mono": [cylinder], "old": [run(None)]})
    figures = ["0.060", "0.070", "1.000", "0.410"]
    assert lines == [["cylinder 64x100x8", *figures], ["grid", *figures]]
    assert len(head) == len(lines[0])
