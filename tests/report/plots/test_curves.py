"""Training curves out of CSV files."""

from omniocc.report.plots.curves import over_seeds, smoothed


def test_seeds_are_compared_at_the_steps_that_all_have():
    curve = over_seeds([{10: 1.0, 20: 2.0, 30: 9.0}, {10: 3.0, 20: 2.5}])
    assert curve.steps == [10, 20]
    assert (curve.mean, curve.low, curve.high) == ([2.0, 2.25], [1.0, 2.0], [3.0, 2.5])
    assert over_seeds([]).steps == []


def test_smoothing_is_a_mean_of_neighbours():
    assert smoothed({0: 0.0, 10: 3.0, 20: 6.0, 30: 0.0}, 3) == {0: 1.5, 10: 3.0, 20: 3.0, 30: 3.0}
