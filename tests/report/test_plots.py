"""What the plots draw."""

import re
from pathlib import Path

import pytest

from omniocc.report.plots import (
    PLOTS,
    as_svg,
    by_candidates,
    by_class,
    by_range,
    over_seeds,
    ranking,
    smoothed,
    training,
    without_math,
)
from omniocc.report.runs import FinishedRun, read_runs
from omniocc.report.selection import by_row


@pytest.fixture(scope="module")
def rows(runs):
    found = by_row(read_runs(runs))
    return {row: found[row] for row in ("ours", "dense", "cuboid")}


def heights(axes) -> list[float]:
    return [bar.get_height() for bar in axes.patches]


def test_bars_stand_for_means_and_whiskers_for_standard_errors(rows):
    (axes,) = by_range(rows).axes
    assert heights(axes) == pytest.approx([0.32, 0.16, 0.08, 0.20, 0.10, 0.05, 0.10, 0.05, 0.025])
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0-8.5 m", "8.5-17 m", "17-25.6 m"]
    (whiskers,) = axes.collections
    low, high = whiskers.get_segments()[0][:, 1]
    assert (high - low) / 2 == pytest.approx(0.02)


def test_every_class_has_its_bar(rows):
    upper, lower = by_class(rows).axes
    assert len(heights(upper)) == 6 * 3
    assert len(heights(lower)) == 5 * 3
    assert heights(upper)[:2] == pytest.approx([0.32, 0.16])


def test_ranking_is_by_mean_with_a_dot_for_each_seed(rows):
    (axes,) = ranking(rows).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["cuboid", "dense", "ours"]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([0.1, 0.2, 0.32])
    dots = [line.get_xdata() for line in axes.lines if line.get_marker() == "o"]
    assert sorted(map(len, dots)) == [1, 1, 2]


def test_names_are_no_formulas(rows):
    figure = ranking(without_math({"a $_$ b$": rows["dense"]}))
    assert "a $_$ b$" in as_svg(figure, "ranking", "Every row")[1]


def test_fractions_of_candidates_and_curves(rows):
    (axes,) = by_candidates(rows).axes
    points = {(float(line.get_xdata()[0]), round(float(line.get_ydata()[0]), 3)) for line in axes.lines}
    assert {(0.25, 0.32), (1.0, 0.2), (0.25, 0.1)} <= points
    validation, loss = training(rows).axes
    assert [value for line in validation.lines for value in line.get_ydata()] == pytest.approx([0.32, 0.2, 0.1])
    assert list(loss.lines[0].get_xdata()) == [0, 10, 20, 30]


def test_classes_are_those_of_the_runs():
    figures = {"test/rayiou/tree": 0.5, "test/rayiou/car": 0.25, "test/rayiou/bus": 0.1}
    upper, lower = by_class({"mine": [FinishedRun("mine-00000001", {}, figures, Path("nowhere"))]}).axes
    names = [[label.get_text() for label in axes.get_xticklabels()] for axes in (upper, lower)]
    assert names == [["tree", "car"], ["bus"]]
    assert heights(upper) == pytest.approx([0.5, 0.25])


def test_nothing_to_draw():
    empty = {"ours": [FinishedRun("ours-00000001", {}, {}, Path("nowhere"))]}
    assert [plot(empty) for _, plot in PLOTS.values()] == [None] * len(PLOTS)


def test_svg_stands_alone_and_follows_the_page(rows):
    _, svg = as_svg(ranking(rows), "a", "Every row")
    assert svg.startswith('<svg role="img" aria-label="Every row"')
    assert not re.search(r"http|<style|<metadata|xmlns|font-family|#1d2430", svg)
    assert "currentColor" in svg
    assert "cuboid" in svg
    names = re.findall(r'\bid="([^"]*)"', svg)
    assert len(names) == len(set(names))
    assert all(name.startswith("a-") for name in names)
    used = re.findall(r'(?:url\(|href=")#([^)"]*)', svg)
    assert used
    assert set(used) <= set(names)


def test_seeds_are_compared_at_the_steps_that_all_have():
    curve = over_seeds([{10: 1.0, 20: 2.0, 30: 9.0}, {10: 3.0, 20: 2.5}])
    assert curve.steps == [10, 20]
    assert (curve.mean, curve.low, curve.high) == ([2.0, 2.25], [1.0, 2.0], [3.0, 2.5])
    assert over_seeds([]).steps == []


def test_smoothing_is_a_mean_of_neighbours():
    assert smoothed({0: 0.0, 10: 3.0, 20: 6.0, 30: 0.0}, 3) == {0: 1.5, 10: 3.0, 20: 3.0, 30: 3.0}
