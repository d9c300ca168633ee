"""Standard errors of gaps over the streets of the test."""

import math

import numpy as np
import pytest
from scipy import stats

from omniocc.report.runs import FinishedRun
from omniocc.report.tables.streets import error_over_streets
from omniocc.runs.scenes import RAYS, save_scenes

KEY, TRUE = "test/rayiou", 100


def run(folder, name: str, shares: list[float]) -> FinishedRun:
    """Return a run that finds a share of the rays of each street and predicts nothing wrong: its score is the mean."""
    counted = {
        f"street-{k}": {RAYS: [[0, TRUE], [0, round(TRUE * share)], [0, round(TRUE * share)]]}
        for k, share in enumerate(shares)
    }
    save_scenes(folder / name, counted, {}, ("Free", "Road"), (1.0,))
    return FinishedRun(name, {}, {}, folder / name)


def test_of_a_mean_over_streets_it_is_that_of_the_mean(tmp_path):
    better, other = [0.5, 0.6, 0.9, 0.3, 0.7], [0.4, 0.6, 0.6, 0.2, 0.8]
    found = error_over_streets([run(tmp_path, "a", better)], [run(tmp_path, "b", other)], KEY)
    assert found == pytest.approx(stats.sem(np.subtract(better, other)))


def test_seeds_of_a_row_are_averaged_street_by_street(tmp_path):
    """One seed is good where the other is bad, so that the mean of both is the same in all streets."""
    seeds = [run(tmp_path, "a-0", [0.2, 0.8, 0.4]), run(tmp_path, "a-1", [0.8, 0.2, 0.6])]
    assert error_over_streets(seeds, [run(tmp_path, "b", [0.3, 0.3, 0.3])], KEY) == pytest.approx(0, abs=1e-6)


def test_it_is_unknown_without_the_same_streets_or_for_other_metrics(tmp_path):
    one, less = run(tmp_path, "a", [0.2, 0.8, 0.4]), run(tmp_path, "b", [0.2, 0.8])
    for pair, key in (
        (([one], [less]), KEY),
        (([one], [FinishedRun("c", {}, {}, tmp_path)]), KEY),
        (([one], [one]), "x"),
    ):
        assert math.isnan(error_over_streets(*pair, key))
