"""Scores of groups of scenes from their counts."""

import json
import math

import pytest

from omniocc.errors import UserError
from omniocc.runs.scenes import LIDAR, MOVING, RAYS, save_scenes, scene_figures, without_each_scene

CLASSES = ("Free", "Road", "Vehicle")
THRESHOLDS_M = (1.0, 2.0)


def counts(true: list[int], predicted: list[int], *correct: list[int]) -> list[list[int]]:
    return [true, predicted, *correct]


ROAD_ONLY = counts([0, 10, 0], [2, 8, 0], [0, 4, 0], [0, 8, 0])
WITH_CAR = counts([0, 10, 10], [0, 10, 10], [0, 10, 0], [0, 10, 5])
SCENES = {
    "a": {RAYS: ROAD_ONLY, LIDAR: WITH_CAR, MOVING: counts([0, 0, 4], [0, 0, 4], [0, 0, 0], [0, 0, 4])},
    "b": {RAYS: WITH_CAR},
}
CONDITIONS = {"a": {"weather": "rain", "place": "campus"}, "b": {"weather": "fog", "place": "campus"}}


@pytest.fixture
def folder(tmp_path):
    save_scenes(tmp_path, SCENES, CONDITIONS, CLASSES, THRESHOLDS_M)
    return tmp_path


def test_counts_of_a_group_are_summed(folder):
    found = scene_figures(folder)
    # a alone: road 4 / (10 + 8 - 4) and 8 / (10 + 8 - 8); no car
    assert found["test/weather/rain/rayiou"] == pytest.approx((4 / 14 + 8 / 10) / 2)
    # b alone: road 1 and 1; car 0 and 5 / 15
    assert found["test/weather/fog/rayiou"] == pytest.approx((1 + 1 + 0 + 1 / 3) / 4)
    # both: road 14 / (20 + 18 - 14) and 18 / (20 + 18 - 18); car as in b
    assert found["test/place/campus/rayiou"] == pytest.approx((14 / 24 + 18 / 20 + 0 + 1 / 3) / 4)
    assert "test/weather/fog/lidar/rayiou" not in found


def test_what_stands_is_all_that_does_not_move(folder):
    """Of the ten rays on cars four move and all are found within 2 m; of the other six one is, of ten predicted."""
    found = scene_figures(folder)
    assert found["test/moving/recall/Vehicle"] == pytest.approx((0 + 4 / 4) / 2)
    assert found["test/standing/recall/Vehicle"] == pytest.approx((0 + 1 / 6) / 2)
    assert found["test/false_alarms/Vehicle"] == pytest.approx((10 - 5) / 10)
    for kind in ("moving/recall", "standing/recall", "false_alarms"):
        assert found[f"test/{kind}"] == found[f"test/{kind}/Vehicle"]
        assert f"test/{kind}/Road" not in found


def test_scenes_that_do_not_tell_what_moves_have_nothing_that_stands(tmp_path):
    """In the first scene six of ten rays hit what stands, and are right; the second, all wrong, does not tell."""
    right, wrong = counts([0, 0, 10], [0, 0, 10], [0, 0, 10]), counts([0, 0, 10], [0, 0, 0], [0, 0, 0])
    moving = counts([0, 0, 4], [0, 0, 4], [0, 0, 4])
    save_scenes(tmp_path, {"a": {LIDAR: right, MOVING: moving}, "b": {LIDAR: wrong}}, {}, CLASSES, (1.0,))
    assert scene_figures(tmp_path)["test/standing/recall/Vehicle"] == 1.0


def test_each_scene_is_left_out_in_turn(folder):
    without = without_each_scene(folder, RAYS)
    assert without == {"a": pytest.approx((1 + 1 + 0 + 1 / 3) / 4), "b": pytest.approx((4 / 14 + 8 / 10) / 2)}
    assert without_each_scene(folder, LIDAR) == {}  # of one scene alone
    assert without_each_scene(folder.parent, RAYS) == {}


def test_a_run_without_counts_has_no_such_scores(tmp_path):
    assert scene_figures(tmp_path) == {}
    save_scenes(tmp_path, {"a": {RAYS: ROAD_ONLY}}, {}, CLASSES, THRESHOLDS_M)
    assert scene_figures(tmp_path) == {}


def test_scores_are_finite_and_the_file_has_a_line_for_each_scene(folder):
    assert all(math.isfinite(value) for value in scene_figures(folder).values())
    lines = (folder / "scenes.json").read_text().splitlines()
    assert [line for line in lines if line.startswith('  "')] == [*lines[3:5]]
    assert json.loads("".join(lines))["scenes"]["b"] == {"conditions": CONDITIONS["b"], RAYS: WITH_CAR}


@pytest.mark.parametrize(
    "text",
    ["{", "[]", '{"scenes": {"a": {}}}', '{"classes": ["Free"], "thresholds_m": [1], "scenes": {"a": {"rays": 1}}}'],
)
def test_a_damaged_file_is_named(tmp_path, text):
    (tmp_path / "scenes.json").write_text(text)
    with pytest.raises(UserError, match=r"scenes\.json is damaged"):
        scene_figures(tmp_path)
