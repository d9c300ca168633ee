import numpy as np

from omniocc.draw.canvas import INK
from omniocc.draw.ranges import (
    FALSE_RANGE,
    NOT_PREDICTED,
    RANGE_TICKS_M,
    SKY,
    error_bar,
    error_colors,
    range_bar,
    range_colors,
    range_scale,
)


def test_near_is_red_far_is_blue_and_sky_and_gaps_have_other_colours():
    colors = range_colors(np.array([[0.2, 1.0, 8.0], [64.0, 500.0, 5.0]])).astype(int)
    assert (colors[0, 0] == colors[0, 1]).all()
    assert (colors[1, 0] == colors[1, 1]).all()
    assert colors[0, 1, 0] > 2 * colors[0, 1, 2]
    assert colors[1, 0, 2] > 2 * colors[1, 0, 0]
    assert range_colors(np.array([np.inf, np.nan])).tolist() == [list(SKY), list(NOT_PREDICTED)]


def test_the_bar_shows_the_colour_of_its_ticks():
    width = 601
    bar = range_bar(width)
    for k, tick in enumerate(RANGE_TICKS_M):
        at = round(k / (len(RANGE_TICKS_M) - 1) * (width - 1))
        assert np.abs(bar[2, at].astype(int) - range_colors(np.array([float(tick)]))[0]).max() <= 4
    assert (bar == INK).all(2).any()


def test_the_scale_is_logarithmic_from_1_to_64_m():
    colors, ticks = range_scale(7)
    assert [range_m for range_m, _ in ticks] == [1, 2, 4, 8, 16, 32, 64]
    assert np.allclose([place for _, place in ticks], [0, 1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6, 1])
    assert colors.tolist() == range_colors(np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0])).tolist()


def test_errors_have_a_side_and_a_size():
    predicted = np.array([5.0, 4.0, 4.9, 9.0, np.nan, 7.0, np.nan, 3.0])
    true = np.array([5.0, 5.0, 5.0, 5.0, 5.0, np.inf, np.inf, np.nan])
    colors = error_colors(predicted, true).astype(int)
    assert (colors[0] == 250).all()
    assert colors[1, 2] - colors[1, 0] > colors[2, 2] - colors[2, 0] > 0
    assert colors[3, 0] - colors[3, 2] > 100
    assert colors[4:].tolist() == [list(NOT_PREDICTED), list(FALSE_RANGE), list(SKY), list(NOT_PREDICTED)]


def test_the_error_bar_is_symmetric_and_white_in_the_middle():
    bar = error_bar(501).astype(int)
    assert (bar[0, 250] == 250).all()
    assert bar[0, 0, 2] > bar[0, 0, 0]
    assert bar[0, -1, 0] > bar[0, -1, 2]
