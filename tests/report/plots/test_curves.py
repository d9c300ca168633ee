"""Training curves out of CSV files."""

from omniocc.report.plots.curves import over_seeds, read_curve, smoothed


def write(folder, version, *lines):
    path = folder / "csv" / f"version_{version}"
    path.mkdir(parents=True)
    (path / "metrics.csv").write_text("\n".join(lines) + "\n")


def test_a_resumed_run_is_one_curve(tmp_path):
    write(tmp_path, 2, "step,val/rayiou,train/loss", "19,,5", "29,0.3,")
    write(tmp_path, 10, "train/loss,step", "4,39")
    write(tmp_path, 0, "step,train/loss,val/rayiou", "9,9,", "19,8,", "19,,0.1", "29,7,")
    assert read_curve(tmp_path, "train/loss") == {9: 9.0, 19: 5.0, 39: 4.0}
    assert read_curve(tmp_path, "val/rayiou") == {29: 0.3}
    assert read_curve(tmp_path / "nothing", "val/rayiou") == {}


def test_seeds_are_compared_at_the_steps_that_all_have():
    curve = over_seeds([{10: 1.0, 20: 2.0, 30: 9.0}, {10: 3.0, 20: 2.5}])
    assert curve.steps == [10, 20]
    assert (curve.mean, curve.low, curve.high) == ([2.0, 2.25], [1.0, 2.0], [3.0, 2.5])
    assert over_seeds([]).steps == []


def test_smoothing_is_a_mean_of_neighbours():
    assert smoothed({0: 0.0, 10: 3.0, 20: 6.0, 30: 0.0}, 3) == {0: 1.5, 10: 3.0, 20: 3.0, 30: 3.0}
