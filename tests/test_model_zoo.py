"""The table of shipped weights: what each was trained on, and the scores of its card."""

import importlib
import sys
from pathlib import Path

import pytest

from omniocc.report.card import card
from omniocc.runs.weights import shipped

ROOT = Path(__file__).parents[1]


@pytest.fixture
def zoo(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tools")
    yield importlib.import_module("model_zoo")
    for name in ("model_zoo", "make_weights"):
        sys.modules.pop(name)


@pytest.fixture
def recipes(zoo, monkeypatch):
    """Return made recipes in place of those of `tools/weights`."""

    def words(scenes: int, **steps: int) -> list[str]:
        return [
            f"data.source.train_scenes={scenes}",
            *(f"preset.stages.{key}.max_steps={n}" for key, n in steps.items()),
        ]

    found = {
        "whole": {"stage": "occupancy", "overrides": words(720, depth=5000, sketch=1500, occupancy=4000)},
        "first": {"stage": "depth", "overrides": words(480, depth=1600)},
        "further": {
            "stage": "depth",
            "overrides": [*words(1440, depth=2400), "stages.depth.weights=tools/weights/first.safetensors"],
        },
        "any": {
            "stage": "occupancy",
            "overrides": [
                *words(960, depth=0, sketch=100, occupancy=300),
                *("weights=whole", "stages.sketch.weights=whole", "stages.depth.weights=further.safetensors"),
            ],
        },
    }
    monkeypatch.setattr(zoo, "recipe_of", found.get)
    return found


def test_steps_of_what_weights_start_from_count_too(zoo, recipes):
    assert zoo.training_of(recipes["further"]) == ({"depth": 4000}, {"depth": 1440})


def test_what_is_used_as_it_is_has_the_scenes_of_its_own_training(zoo, recipes):
    steps, scenes = zoo.training_of(recipes["any"])
    assert steps == {"depth": 4000, "sketch": 1600, "occupancy": 4300}
    assert scenes == {"depth": 1440, "sketch": 960, "occupancy": 960}


def test_scores_are_those_on_unseen_scenes(zoo):
    keys = ("test/rayiou", *(f"test/rayiou_{band}" for band in zoo.BANDS))
    metrics = dict(zip(keys, (0.5, 0.7, 0.6, 0.3), strict=True))
    text = card("mine", {"good_for": "tests"}, {}, metrics, {"test/rayiou": 0.1})
    assert zoo.scores_of(text) == ["0.500", "0.700", "0.600", "0.300"]
    assert zoo.scores_of(card("mine", {"good_for": "tests"}, {}, {}, {"test/rayiou": 0.1})) == ["–"] * 4


@pytest.mark.parametrize("name", shipped())
def test_every_shipped_recipe_says_what_it_is_and_how_it_is_used(name, zoo):
    recipe = zoo.recipe_of(name)
    assert recipe["what"]
    assert recipe["use"].startswith("python src/")
    assert name in recipe["use"]
