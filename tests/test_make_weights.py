"""The recipes of the shipped weights, and packing a finished run with its card."""

import importlib.util
import re
from pathlib import Path

import pytest
import torch
import yaml
from omegaconf import OmegaConf

from omniocc.config import build, check_root, compose_plain
from omniocc.errors import UserError
from omniocc.report.card import card, frame_rows
from omniocc.runs.checkpoint import load_checkpoint
from omniocc.runs.checkpoint_io import LAST, write_checkpoint
from omniocc.runs.results import save_results
from omniocc.runs.weights import SHIPPED, SUFFIX, digest_of, pack_weights, read_weights, shipped

ROOT = Path(__file__).parents[1]
NAMES = sorted(path.stem for path in (ROOT / "tools" / "weights").glob("*.yaml"))


@pytest.fixture
def tool(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("make_weights", ROOT / "tools" / "make_weights.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "SHIPPED", tmp_path / "weights")
    return module


@pytest.mark.parametrize("name", NAMES)
def test_every_recipe_is_a_configuration_that_trains(name, tool, tmp_path):
    recipe = tool.recipe_of(name)
    config = compose_plain(ROOT / "conf", "train", recipe["overrides"])
    check_root(OmegaConf.create(config))
    folder, checkpoint = tool.folder_of(recipe, tmp_path)
    own = f"weights_{name.replace('-', '_')}-"
    assert folder.name.startswith(own if recipe["stage"] == "occupancy" else "depth-")
    assert checkpoint == ("best.ckpt" if recipe["stage"] == "occupancy" else "last.ckpt")
    for key in recipe.get("shipped", {}):
        assert key == "occupied_above" or OmegaConf.select(OmegaConf.create(config), key) is not None


def test_a_recipe_may_be_like_another_and_a_wrong_name_is_answered(tool):
    first, further = (tool.recipe_of(name)["overrides"] for name in ("any-rig-depth", "any-rig-8000"))
    assert further[: len(first)] == first
    assert "data.source.rig=any" in further[len(first) :]
    with pytest.raises(
        UserError,
        match=r"NAME=large: choose one of any-rig, any-rig-480, any-rig-8000, any-rig-depth, tiny, tiny-depth",
    ):
        tool.recipe_of("large")


def test_a_recipe_that_starts_from_another_trains_that_one_first(tool, tmp_path, monkeypatch):
    monkeypatch.setattr(tool, "ROOT", tmp_path)
    monkeypatch.setattr(tool, "RECIPES", tmp_path / "recipes")
    tool.RECIPES.mkdir()
    (tool.RECIPES / "first.yaml").write_text("stage: depth\nis_start: true\noverrides: [a=1, b=1]\n")
    (tool.RECIPES / "second.yaml").write_text(
        "like: first\nis_start: false\nstarts_from: first\nmore_overrides: [a=2]\n"
    )
    assert tool.recipe_of("second")["overrides"] == [
        "a=1",
        "b=1",
        "a=2",
        "stages.depth.weights=recipes/first.safetensors",
    ]
    made = []
    monkeypatch.setattr(tool, "train", lambda recipe: "command")
    monkeypatch.setattr(tool, "folder_of", lambda recipe, runs: (tmp_path, LAST))
    monkeypatch.setattr(tool, "pack", lambda name, *rest: made.append(name))
    tool.main([])
    assert made == ["first", "second"]
    (tool.RECIPES / "first.safetensors").touch()
    tool.main(["second"])
    assert made == ["first", "second", "second"]
    assert tool.file_of("first", True).parent == tool.RECIPES
    assert tool.file_of("second", False).parent == tool.SHIPPED


def test_a_finished_stage_is_packed_with_its_card(tool, tmp_path, monkeypatch):
    monkeypatch.setattr(tool, "FRAMES", tmp_path)
    monkeypatch.setattr(tool, "record_frames", lambda recipe, folder: folder.mkdir())
    monkeypatch.setattr(
        tool, "figures_of", lambda weights, frames: {"test/depth/mae": float(frames == tmp_path / "small")}
    )
    weights = {"model.a": torch.randn(20, 30)}
    config = {"data": {"source": {"train_scenes": 2000}}, "depth": {"_target_": "omniocc.model.depth.OmniMVS"}}
    write_checkpoint({"stage": "depth", "config": config, "state_dict": weights}, tmp_path / "run" / LAST)
    facts = {"steps": 12, "seed": 0, "commit": "0ce6810", "data": "f" * 64}
    metrics = {"test/depth/mae": 1.5, "test/depth/mae_0-8.5m": 0.2, "test/depth/mae_8.5-17m": float("nan")}
    save_results(tmp_path / "run", metrics, facts)
    recipe = {"half": True, "shipped": {"data.source.train_scenes": 240}, "good_for": "trying", "not_good_for": "cars"}
    path = tool.pack("small", recipe, tmp_path / "run", LAST, "python src/train.py stage=depth")
    trained = load_checkpoint(path)
    assert trained.config.data.source.train_scenes == 240
    torch.testing.assert_close(trained.weights["model.a"], weights["model.a"], atol=2e-3, rtol=1e-3)
    text = path.with_suffix(".md").read_text()
    for part in ("# small", "Good for trying.", "Not good for cars.", "`python src/train.py stage=depth`", "`0ce6810`"):
        assert part in text
    assert "| MAE, m | 1.500 |" in text
    assert "| MAE, m, 0-8.5 m | 0.200 |" in text
    assert "| MAE, m, 8.5-17 m | - |" in text
    assert "| MAE, m | 1.0000 |" in text.split("On the four frames of the tests")[1]
    tool.LIMIT_MB = 1e-4
    with pytest.raises(UserError, match=r"at most 0\.0001 MB"):
        tool.pack("small", recipe, tmp_path / "run", LAST, "")


def test_the_card_of_a_whole_chain_has_scores_by_distance_and_class():
    metrics = {"test/rayiou": 0.5, "test/rayiou_17-25.6m": 0.3, "test/rayiou/Pole": 0.2, "test/lidar/rayiou": 0.3}
    others = {"val/rayiou": 0.6, "test/lidar/rayiou/Pole": 0.1}
    text = card("tiny", {"good_for": "demos"}, {"steps": 3}, metrics | others, {"test/voxel/miou": 0.123456})
    for row in (
        "| voxel RayIoU | 0.500 |",
        "| voxel RayIoU, 17-25.6 m | 0.300 |",
        "| voxel RayIoU, Pole | 0.200 |",
        "| surface RayIoU | 0.300 |",
        "| voxel mIoU | 0.1235 |",
    ):
        assert row in text
    assert "0.600" not in text
    assert "Errors of range" not in text
    assert "Not good" not in text


@pytest.mark.whole_runs
def test_frames_are_recorded_once_and_give_figures(tool, tmp_path):
    recipe = {"stage": "depth", "overrides": ["preset=smoke", "stage=depth", "data.source.workers=0"]}
    config = tool.config_of(recipe)
    weights = {f"model.{name}": value for name, value in build(config.depth).state_dict().items()}
    path = tmp_path / "x.safetensors"
    pack_weights(path, "depth", OmegaConf.to_container(config, resolve=True), weights, {})
    trained, frames = tool.load(path), tmp_path / "frames"
    tool.record_frames(trained, frames)
    scenes = sorted(path.name for path in frames.iterdir() if path.is_dir())
    assert [name[:9] for name in scenes] == ["test-000-", "test-001-"]
    (frames / scenes[0] / "frames-000.tar").touch()
    before = (frames / scenes[0] / "frames-000.tar").stat().st_mtime_ns
    tool.record_frames(trained, frames)
    assert (frames / scenes[0] / "frames-000.tar").stat().st_mtime_ns == before
    figures = tool.figures_of(path, frames)
    assert 0 < figures["test/depth/mae"] < 100
    assert figures == tool.figures_of(path, frames)


def test_recipes_hold_nothing_else():
    known = {"like", "stage", "half", "overrides", "shipped", "what", "use", "good_for", "not_good_for"}
    known |= {"is_start", "starts_from", "more_overrides", "frames"}
    for name in NAMES:
        assert set(yaml.safe_load((ROOT / "tools" / "weights" / f"{name}.yaml").read_text())) <= known


@pytest.mark.whole_runs
@pytest.mark.slow
@pytest.mark.parametrize("name", shipped())
def test_each_shipped_file_gives_the_figures_of_its_card(name, tool):
    """On frames that are stored with the tests, so that later changes of the world do not touch them."""
    path = SHIPPED / f"{name}{SUFFIX}"
    text = path.with_suffix(".md").read_text()
    assert path.stat().st_size <= tool.LIMIT_MB * 1e6
    assert f"`{digest_of(read_weights(path)[0]['state_dict'])}`" in text
    recipe = tool.recipe_of(name)
    found = tool.figures_of(path, tool.FRAMES / recipe.get("frames", name))
    stated = re.findall(r"^\| (.+) \| ([\d.]+) \|$", text.split("On the four frames of the tests")[1], re.MULTILINE)
    rows = dict(re.findall(r"^\| (.+) \| ([\d.]+) \|$", "\n".join(frame_rows(found)), re.MULTILINE))
    assert stated
    assert rows.keys() == dict(stated).keys()
    for title, value in stated:
        assert float(rows[title]) == pytest.approx(float(value), rel=2e-3, abs=2e-4), title
