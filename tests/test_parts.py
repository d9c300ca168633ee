"""There is one place where a configuration becomes objects, and options are known by their slot alone."""

import ast
import re
from pathlib import Path

import pytest

from omniocc.parts import Parts

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
GRIDS = {"Cylinder", "Cuboid"}
"""Voxel grids are values with coordinates of their own, not options alone: files and pictures tell them apart."""


def calls(path: Path, *names: str) -> list[ast.Call]:
    found = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    return [call for call in found if isinstance(call.func, ast.Name) and call.func.id in names]


def imported(path: Path) -> set[str]:
    nodes = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.ImportFrom)]
    return {f"{node.module}.{alias.name}" for node in nodes for alias in node.names}


def test_one_module_builds_from_a_configuration():
    builders = {path.name for path in SOURCES if "omniocc.config.build" in imported(path)}
    assert builders == {"parts.py"}
    assert {path.name for path in SOURCES if "hydra.utils.instantiate" in imported(path)} == {"config.py"}


def test_no_module_asks_for_the_class_of_an_option_of_a_slot():
    """Protocols and attributes say what an option can do; only options of one slot know each other."""
    texts = [path.read_text() for path in (ROOT / "conf").rglob("*.yaml")]
    slots = {
        name.rpartition(".")[2]: name
        for text in texts
        for name in re.findall(r"_target_: (omni(?:occ|world)[\w.]+)", text)
    }
    assert {"VirtualWorld", "Omni", "NoSemanticHead", "CarlaRecorder"} <= slots.keys()
    asked = []
    for path in SOURCES:
        module = ".".join(path.relative_to(ROOT / "src").with_suffix("").parts)
        for call in calls(path, "isinstance", "issubclass"):
            named = {node.id for node in ast.walk(call.args[1]) if isinstance(node, ast.Name)} & slots.keys()
            asked += [f"{path}:{call.lineno}: {name}" for name in named - GRIDS if not of_slot(module, slots[name])]
    assert not asked


def of_slot(module: str, option: str) -> bool:
    return module.startswith(f"{option.rpartition('.')[0]}.")


def test_parts_are_new_objects_with_the_values_of_the_configuration(smoke):
    parts = Parts(smoke())
    assert parts.model() is not parts.model()
    assert parts.recipe("occupancy").max_steps == parts.cfg.stages.occupancy.max_steps
    assert parts.data(window=3).window == 3


@pytest.mark.parametrize("key", ["data.batch_size=3", "stages.occupancy.batch_size=3"])
def test_the_batch_of_the_last_stage_has_two_names(smoke, key):
    assert Parts(smoke(key)).recipe("occupancy").batch_size == 3


def test_the_recipe_of_the_last_stage_follows_the_short_keys(smoke):
    recipe = Parts(smoke("seed=5", "optimizer.learning_rate=0.25", "weights=tiny")).recipe("occupancy")
    assert (recipe.seed, recipe.optimizer.learning_rate, recipe.weights) == (5, 0.25, "tiny")


def test_without_a_head_is_another_configuration(smoke):
    parts = Parts(smoke("model=extended"))
    without = parts.without_head()
    assert (parts.has_head, without.has_head) == (True, False)
    assert (parts.cfg.model.hints.pixel_classes, without.cfg.model.hints.pixel_classes) == (True, False)
    assert not list(without.model().semantic_head.parameters())
