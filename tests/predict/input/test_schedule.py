import pytest

from omniocc.predict.input.schedule import Lift, schedule


def frames_of(lifts):
    return [lift.frame for lift in lifts]


def test_a_whole_sequence_is_lifted_once():
    lifts = schedule(range(5), 3, "stream")
    assert lifts == [Lift(k, True, k == 0) for k in range(5)]


def test_the_rest_of_a_sequence_gets_its_history():
    lifts = schedule([1, 7, 8], 3, "stream")
    assert frames_of(lifts) == [0, 1, 5, 6, 7, 8]
    assert [lift.frame for lift in lifts if lift.wanted] == [1, 7, 8]
    assert [lift.frame for lift in lifts if lift.reset] == [0]


@pytest.mark.parametrize("wanted", [[0], [3], [0, 1, 2], [2, 4, 9], [1, 5, 6, 12], list(range(13))])
def test_every_wanted_frame_follows_the_frames_of_its_window(wanted):
    window = 4
    for history in ("stream", "window"):
        seen = []
        for lift in schedule(wanted, window, history):
            seen = [lift.frame] if lift.reset else [*seen, lift.frame]
            if lift.wanted:
                expected = list(range(max(0, lift.frame - window + 1), lift.frame + 1))
                assert seen[-window:] == expected


def test_without_history_every_frame_stands_alone():
    assert schedule([2, 3], 4, "none") == [Lift(2, True, True), Lift(3, True, True)]
    assert schedule([], 4, "stream") == schedule([], 4, "window") == []
