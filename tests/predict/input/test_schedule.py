import pytest

from omniocc.predict.input.schedule import Visit, schedule


def moments(visits):
    return [visit.moment for visit in visits]


def test_a_whole_drive_is_lifted_once():
    visits = schedule(range(5), 3, "stream")
    assert visits == [Visit(k, True, k == 0) for k in range(5)]


def test_what_is_left_of_a_drive_gets_its_history_back():
    visits = schedule([1, 7, 8], 3, "stream")
    assert moments(visits) == [0, 1, 5, 6, 7, 8]
    assert [visit.moment for visit in visits if visit.wanted] == [1, 7, 8]
    assert [visit.moment for visit in visits if visit.reset] == [0]


@pytest.mark.parametrize("wanted", [[0], [3], [0, 1, 2], [2, 4, 9], [1, 5, 6, 12], list(range(13))])
def test_before_every_wanted_moment_come_exactly_those_of_its_window(wanted):
    frames = 4
    for history in ("stream", "window"):
        seen = []
        for visit in schedule(wanted, frames, history):
            seen = [visit.moment] if visit.reset else [*seen, visit.moment]
            if visit.wanted:
                expected = list(range(max(0, visit.moment - frames + 1), visit.moment + 1))
                assert seen[-frames:] == expected


def test_without_history_every_moment_stands_alone():
    assert schedule([2, 3], 4, "none") == [Visit(2, True, True), Visit(3, True, True)]
    assert schedule([], 4, "stream") == schedule([], 4, "window") == []
