"""Facts about scenes on the page of a dataset."""

import sys
from pathlib import Path

import pytest

from omniocc.camera import Rig
from omniocc.report.datasets import own_row
from omniworld.page import frame_at, pinhole_twin, speed_mps, time_of_day
from omniworld.plans import ScenePlan

sys.path.insert(0, str(Path(__file__).parents[2] / "data"))
from fake_scene import HEIGHT, WIDTH, FakeWorld


def scene_of(root, rig="fisheye6", **choices):
    world = FakeWorld(root, scenes=(1, 0, 0), **choices)
    world.rig = Rig.load(rig).resized(WIDTH, HEIGHT)
    world.prepare()
    return world.scenes("train")[0]


def test_a_pinhole_dataset_of_the_same_scenes_is_found(tmp_path):
    scene = scene_of(tmp_path)
    assert pinhole_twin(scene) is None
    assert own_row([scene], [None]) == ("This dataset", False, True, True, True, True, 4)
    scene_of(tmp_path, "pinhole6", seed=1)
    assert pinhole_twin(scene) is None
    twin = scene_of(tmp_path, "pinhole6", frames=3)
    found = pinhole_twin(scene)
    assert found is not None
    assert found.folder == twin.folder
    assert pinhole_twin(twin) is None
    assert own_row([scene], [found]) == ("This dataset", True, True, True, True, True, 4)
    assert [frame_at(twin, time_s) for time_s in (0.0, 1.0, 1.5)] == [0, 2, None]


def test_a_scene_in_other_weather_is_not_the_same(tmp_path):
    scene = scene_of(tmp_path)
    twin = scene_of(tmp_path, "pinhole6")
    twin.meta["facts"]["weather"] = scene.meta["facts"]["weather"]
    scene.meta["facts"]["weather"] = "fog"
    assert pinhole_twin(scene) is None


def test_speed_is_that_of_the_poses(tmp_path):
    scene = scene_of(tmp_path)
    assert [speed_mps(scene, frame) for frame in (0, 3)] == [6.0, 6.0]
    assert speed_mps(scene_of(tmp_path, frames=1), 0) == 0.0


@pytest.mark.parametrize(
    ("weather", "words"),
    [
        ("clear", {"day, sun 5", "morning or evening, sun 1"}),
        ("dusk", {"dusk, sun 3", "dusk, sun 6"}),
        ("rain", {"day, sun hidden"}),
        ("fog", {"day, sun hidden"}),
    ],
)
def test_the_time_of_day(tmp_path, weather, words):
    world = FakeWorld(tmp_path)
    plans = [ScenePlan("", "train", "suburb", seed) for seed in range(30)]
    described = {
        time_of_day({"theme": plan.theme, "seed": plan.seed, "weather": weather, "recipe": world.recipe})
        for plan in plans
    }
    assert all(any(text.startswith(word) for text in described) for word in words), described
    assert time_of_day({"recipe": {"world": "another"}}) == ""
